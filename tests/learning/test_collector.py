"""Buffers against the same actions taken by TorchRL's own loop."""

from __future__ import annotations

import pytest
import torch

from needlehoop.config import composing
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.collectors import Collector
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import build_agent
from needlehoop.learning.parallel import ParallelAgent

SMALL = [
    "cams=[dep_front,seg_side]",
    "num_envs=5",
    "image_size=32",
    "episode.max_steps=6",
    "obs.proprio=true",
    "engine.threads=1",
]
HORIZON = 8


@pytest.fixture(scope="module", params=[[], ["obs.frame_stack=2"], ["cams=[]", "obs=signals"]])
def collected(request):
    """Two buffers, their cuts, the agent, and an environment that has not begun."""
    job = typed_job(composing.compose([*SMALL, *request.param], "job"))
    torch.manual_seed(0)
    env = TorchRLEnv(job.env, stagger=True)
    agent = build_agent(job, torch.device("cpu"))
    workers = Workers(2)
    collector = Collector(env, ParallelAgent(agent, 3, workers), HORIZON, workers)
    pairs = [tuple(part.clone() for part in collector.collect()) for _ in range(2)]
    return pairs, agent, TorchRLEnv(job.env, stagger=True)


def test_a_buffer_is_what_torchrls_loop_makes_of_its_actions(collected):
    pairs, agent, env = collected
    now = env.reset()
    for buffer, after in pairs:
        cuts = {}
        for step in range(HORIZON):
            kept = buffer[:, step]
            seen = agent.prepare(*(now[key] for key in agent.in_keys))
            for key, value in zip(agent.seen_keys, seen, strict=True):
                assert torch.equal(kept[key], value), key
            now["action"] = kept["action"]
            both, now = env.step_and_maybe_reset(now)
            told = kept["next"].keys(True, True)
            assert {"reward", "done", "potential", ("facts", "threaded")} <= set(told)
            assert [
                key for key in told if not torch.equal(kept["next"][key], both["next"][key])
            ] == []
            for row in range(len(kept)):
                if both["next", "truncated"][row] or step == HORIZON - 1:
                    cuts[row, step] = both["next"].select(*agent.in_keys)[row]
        assert len(after) == len(cuts) > 5
        for place, row in enumerate(sorted(cuts)):
            for key in agent.in_keys:
                assert torch.equal(after[place][key], cuts[row][key])


def test_the_parallel_agents_outputs_are_those_of_the_agent(collected):
    pairs, agent, _ = collected
    buffer, _ = pairs[1]
    with torch.no_grad():
        loc, scale, value = agent(*(buffer[key].flatten(0, 1) for key in agent.seen_keys))
    for key, again in (("state_value", value), ("scale", scale)):
        torch.testing.assert_close(buffer[key].flatten(0, 1), again, rtol=2e-2, atol=2e-2)
    policy = torch.distributions.Normal(loc, scale)
    expected = policy.log_prob(buffer["action"].flatten(0, 1)).sum(-1)
    torch.testing.assert_close(buffer["action_log_prob"].flatten(), expected, rtol=5e-2, atol=5e-2)
