"""Proximal policy optimisation: on buffers made by hand, and on a task that a test has time for."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tiny_runs import learner
from torchrl.data import Composite, Unbounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.networks import HeadConfig, Normalizer, PolicySpec, ValueAgent
from needlehoop.learning.ppo import Ppo

ENCODER = EncoderConfig(name="small", stem=2, channels=(2, 2), blocks=1)
HEADS = HeadConfig(hidden=16, layers=1, sigma=0.6, shared=True, privileged_facts=())
ENVS, STEPS = 3, 8
SEEN = Composite(signals=Unbounded(shape=(ENVS, 4)), shape=(ENVS,))
VALUES = {
    "horizon": STEPS,
    "minibatch": 6,
    "epochs": 2,
    "learning_rate": 1e-2,
    "gamma": 0.9,
    "lam": 0.8,
    "beta": 1e-3,
    "epsilon": 0.2,
    "epsilon_end": 0.1,
    "value_coefficient": 0.5,
    "clip_value": True,
    "network": HEADS,
}


def make_agent(seed: int = 0, heads: HeadConfig = HEADS) -> ValueAgent:
    torch.manual_seed(seed)
    spec = PolicySpec({}, 8, {"signals": 4}, ENCODER, heads, "tool", 2, "fp32")
    return ValueAgent(spec, torch.device("cpu"))


def make_ppo(agent: ValueAgent, updates: int = 4, seed: int = 0, **changed) -> Ppo:
    return Ppo(agent, PpoConfig(**{**VALUES, **changed}), updates, seed)


def flags(*places: tuple[int, int]) -> torch.Tensor:
    marked = torch.zeros(ENVS, STEPS, 1, dtype=torch.bool)
    for env, step in places:
        marked[env, step] = True
    return marked


NEVER = flags()
ALWAYS = ~NEVER


def make_buffer(
    agent: ValueAgent,
    seed: int = 0,
    terminated: torch.Tensor = NEVER,
    truncated: torch.Tensor = NEVER,
) -> TensorDict:
    """What a collector would hand over: a new episode begins after every end."""
    torch.manual_seed(seed)
    done = terminated | truncated
    seen, elsewhere = (torch.stack([SEEN.rand() for _ in range(STEPS)], 1) for _ in range(2))
    following = torch.cat((seen[:, 1:], elsewhere[:, -1:]), 1).clone()
    following[done.squeeze(-1)] = elsewhere[done.squeeze(-1)]
    buffer = seen.clone()
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        output = outputs(agent, seen)
    buffer.update(output.select("loc", "scale", "state_value", "action", "action_log_prob"))
    ends = {"done": done, "terminated": terminated, "truncated": truncated}
    buffer["next"] = following.update({"reward": torch.randn(ENVS, STEPS, 1), **ends})
    return buffer


def outputs(agent: ValueAgent, seen: TensorDictBase) -> TensorDictBase:
    return make_ppo(agent).policy(seen.select(*agent.in_keys))


def values_of(agent: ValueAgent, seen: TensorDictBase) -> torch.Tensor:
    return outputs(agent, seen)["state_value"]


def plain_advantages(
    agent: ValueAgent, buffer: TensorDict, gamma: float, lam: float, horizon: int
) -> torch.Tensor:
    """Generalised advantages, one step after the other; every successor is looked at anew."""
    with torch.no_grad():
        successors = values_of(agent, buffer["next"])
    ends = buffer["next"]
    advantages = torch.zeros(ENVS, STEPS)
    for env in range(ENVS):
        later = 0.0
        for step in reversed(range(STEPS)):
            future = 0.0 if ends["terminated"][env, step] else float(successors[env, step])
            value = float(buffer["state_value"][env, step])
            surprise = float(ends["reward"][env, step]) + gamma * future - value
            goes_on = not bool(ends["done"][env, step]) and (step + 1) % horizon > 0
            later = surprise + gamma * lam * later * goes_on
            advantages[env, step] = later
    return advantages.unsqueeze(-1)


ENDINGS = {
    "none": (NEVER, NEVER),
    "both": (flags((0, 2), (1, 5), (1, 7)), flags((0, 4), (2, 3), (2, 4), (2, 7))),
    "both at once": (flags((0, 3), (1, 7)), flags((0, 3), (1, 7))),
}


@pytest.mark.parametrize(
    ("endings", "horizon"), [*((name, STEPS) for name in ENDINGS), ("both", 4)]
)
def test_time_outs_bootstrap_and_terminations_do_not_and_a_horizon_cuts(endings, horizon):
    agent = make_agent()
    buffer = make_buffer(agent, 1, *ENDINGS[endings])
    expected = plain_advantages(agent, buffer, VALUES["gamma"], VALUES["lam"], horizon)
    values = buffer["state_value"].clone()
    make_ppo(agent, horizon=horizon).update(buffer)
    torch.testing.assert_close(buffer["value_target"], expected + values, atol=1e-5, rtol=1e-5)
    standardised = (expected - expected.mean()) / expected.std()
    torch.testing.assert_close(buffer["advantage"], standardised, atol=1e-4, rtol=1e-4)


def test_both_schedules_fall_linearly_over_the_updates():
    agent = make_agent()
    ppo = make_ppo(agent, updates=5)
    turns = [ppo.update(make_buffer(agent, seed)) for seed in range(6)]
    left = [1.0, 0.8, 0.6, 0.4, 0.2, 0.0]
    rates = [losses["learning_rate"] for losses in turns]
    assert rates == pytest.approx([1e-2 * share for share in left], abs=1e-9)
    assert min(rates) > 0
    epsilons = [losses["epsilon"] for losses in turns]
    assert epsilons == pytest.approx([0.1 + 0.1 * share for share in left])
    assert ppo.done_updates == 6


def test_vectors_are_standardised_by_the_buffers_that_were_learnt_from():
    agent = make_agent(heads=replace(HEADS, shared=False))
    ppo = make_ppo(agent)
    buffers = [make_buffer(agent, seed) for seed in range(2)]
    for buffer in buffers:
        ppo.update(buffer)
    normalizers = [module for module in agent.modules() if isinstance(module, Normalizer)]
    rows = torch.cat([buffer["signals"] for buffer in buffers]).flatten(0, 1)
    # The policy's, and that of the value function's own trunk.
    assert len(normalizers) == 2
    for normalizer in normalizers:
        assert int(normalizer.count) == len(rows)
        torch.testing.assert_close(normalizer.mean.float(), rows.mean(0))


def test_values_that_foresee_everything_explain_all_variance():
    agent = make_agent()
    buffer = make_buffer(agent)
    with torch.no_grad():
        successors = values_of(agent, buffer["next"])
    buffer["next", "reward"] = buffer["state_value"] - VALUES["gamma"] * successors
    assert make_ppo(agent).update(buffer)["explained_variance"] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("clip_value", [True, False])
def test_the_policy_learns_which_action_pays(clip_value):
    """One-step episodes that pay for an action near (0.5, -0.5)."""
    agent = make_agent()
    ppo = make_ppo(agent, updates=100, minibatch=ENVS * STEPS, clip_value=clip_value)
    best = torch.tensor([0.5, -0.5])
    distances, turns = [], []
    for seed in range(40):
        buffer = make_buffer(agent, seed, terminated=ALWAYS)
        buffer["next", "reward"] = -(buffer["action"] - best).square().sum(-1, keepdim=True)
        distances.append(float((buffer["loc"] - best).norm(dim=-1).mean()))
        turns.append(ppo.update(buffer))
    assert distances[-1] < 0.6 * distances[0]
    assert turns[-1]["loss_value"] < 0.6 * turns[0]["loss_value"]
    assert all(math.isfinite(value) for losses in turns for value in losses.values())


REACH = [
    *("obs=signals", "task=near", "reward.rate=1", "reward.grasp=2", "reward.lift=0"),
    *("steps=8000", "num_envs=40", "episode.max_steps=20", "engine.threads=1"),
    *("algo.horizon=20", "algo.minibatch=80", "algo.epochs=8", "algo.learning_rate=1e-3"),
]
"""Ten buffers of one episode each: time to come near the needle, under a reward seen from afar."""


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 5])
def test_the_return_rises(seed):
    """By more than chance: without learning, such means differ by 0.03 at most."""
    turns = learner(*REACH, f"seed={seed}")
    returns = [float(buffer["next", "potential"][:, -1].mean()) for buffer, _ in turns]
    first, second, *_, third_last, second_last, last = returns
    assert (third_last + second_last + last) / 3 > (first + second) / 2 + 0.08
