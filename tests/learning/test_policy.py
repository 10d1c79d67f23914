"""Weights in a file, a policy out of it, and the same as ONNX."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save
from tensordict import TensorDict
from tiny_runs import TINY, composed, run_composed

import needlehoop
from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import build_agent
from needlehoop.learning.policy import write_weights
from needlehoop.runs.run import Run

WORDS = [
    "cams=[dep_front,seg_side]",
    "obs.proprio=true",
    "image_size=32",
    "precision=fp32",
    "episode.max_steps=8",
    "num_envs=4",
]


def trained(folder, *words, weights="float32"):
    """A run whose agent is no longer what it began as, its checkpoint and weights."""
    values = composing.compose([*WORDS, *words], "config")
    job = typed_job(values)
    run = Run.create(folder, values, "", overwrite=False)
    torch.manual_seed(3)
    agent = build_agent(job, torch.device("cpu"))
    with torch.no_grad():
        for parameter in agent.parameters():
            parameter += 0.02 * torch.randn_like(parameter)
    for module in agent.modules():
        if hasattr(module, "learn"):
            module.learn(torch.randn(50, len(module.mean)))
    learner = {"ppo": {"agent": agent.state_dict()}}
    run.save({"learner": learner, "update": 1, "wall_time": 1.0})
    write_weights(folder / "policy.safetensors", job.spec, agent.actor, values, weights)
    return agent


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    return folder, trained(folder)


def act(agent, seen):
    with torch.no_grad():
        observed = [seen[key] for key in agent.in_keys if key[0] != "facts"]
        return agent.actor(*observed).clamp(-1, 1)


def test_a_loaded_policy_acts_as_its_agent(run):
    folder, agent = run
    env = needlehoop.make_env_of(folder, num_envs=3)
    # Of the run, on episodes that it has not met.
    setup = env.settings
    assert (setup.cams, setup.image_size, setup.seed) == (("dep_front", "seg_side"), 32, 1_000_001)
    seen = env.reset()
    policy = needlehoop.load_policy(folder)
    assert torch.equal(policy(seen), act(agent, seen))
    # Without policy.safetensors it is the checkpoint that is read; alone the former is enough.
    alone = needlehoop.load_policy(folder / "policy.safetensors")
    assert torch.equal(alone(seen), policy(seen))
    (folder / "policy.safetensors").rename(folder / "kept")
    try:
        assert torch.equal(needlehoop.load_policy(folder)(seen), policy(seen))
    finally:
        (folder / "kept").rename(folder / "policy.safetensors")


def test_numpy_or_torch_one_or_many_channels_first_or_last(run):
    folder, _ = run
    policy = needlehoop.load_policy(folder)
    seen = needlehoop.make_env_of(folder, num_envs=3).reset()
    many = policy(seen)
    assert many.dtype == torch.float32
    assert many.shape == (3, 5)
    flat = {**seen["pixels"].to_dict(), "proprio": seen["proprio"]}
    assert torch.equal(policy(flat), many)
    last = {n: v.movedim(1, -1).numpy() if v.ndim == 4 else v.numpy() for n, v in flat.items()}
    assert np.array_equal(policy(last), many)
    single = policy({name: value[1] for name, value in last.items()})
    assert isinstance(single, np.ndarray)
    np.testing.assert_allclose(single, many[1], atol=1e-5)
    nested = policy(TensorDict({"pixels": seen["pixels"], "proprio": seen["proprio"]}, [3])[None])
    assert torch.equal(nested[0], many)


def test_it_flies_gymnasium_s_environment_of_the_run(run):
    import gymnasium

    policy = needlehoop.load_policy(run[0])
    env = gymnasium.make("needlehoop:needlehoop/NeedleHoop-v0", run=run[0])
    seen, _ = env.reset(seed=1)
    for _ in range(8):
        action = policy(seen)
        assert action in env.action_space
        seen, *_, truncated, _ = env.step(action)
    assert truncated


def test_a_file_holds_the_policy_alone_and_bfloat16_halves_it(run, tmp_path):
    folder, _ = run
    trained(tmp_path / "half", weights="bfloat16")
    full, half = (f / "policy.safetensors" for f in (folder, tmp_path / "half"))
    assert {name.split(".")[0] for name in load_file(full)} == {"trunk", "head"}
    assert half.stat().st_size < 0.55 * full.stat().st_size
    seen = needlehoop.make_env_of(folder, num_envs=3).reset()
    exact, rough = needlehoop.load_policy(full)(seen), needlehoop.load_policy(half)(seen)
    assert not torch.equal(exact, rough)
    assert (exact - rough).abs().mean() < 0.05


def test_what_is_no_policy_is_told_in_a_line(run, tmp_path):
    with safe_open(run[0] / "policy.safetensors", framework="pt") as file:
        notes = file.metadata()
    bad = tmp_path / "policy.safetensors"
    for content, message in (
        (b"\x80\x04cos\nsystem\n", "is damaged"),
        (save({"a": torch.zeros(1)}, notes), "does not fit its config"),
    ):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match=message) as raised:
            needlehoop.load_policy(bad)
        assert "\n" not in str(raised.value)
    with pytest.raises(ValueError, match="no such file"):
        needlehoop.load_policy(tmp_path / "none.safetensors")


def test_an_observation_that_does_not_fit_is_told_by_its_key(run):
    policy = needlehoop.load_policy(run[0])
    fit = {
        "dep_front": np.zeros((32, 32, 4), np.uint8),
        "seg_side": np.zeros((32, 32, 3), np.uint8),
        "proprio": np.zeros(8),
    }
    assert policy(fit).shape == (5,)
    for change, message in (
        ({"seg_side": np.zeros((32, 32, 3))}, "seg_side: torch.float64"),
        ({"proprio": np.zeros(7)}, r"proprio: shape \(7,\); expected \(…, 8\)"),
    ):
        with pytest.raises(ValueError, match=message):
            policy({**fit, **change})
    del fit["dep_front"]
    with pytest.raises(ValueError, match="dep_front missing; the policy sees dep_front, seg_side"):
        policy(fit)


def test_a_policy_in_onnx_acts_as_in_torch(elsewhere, capsys):
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    words = [*TINY, "cams=[dep_front,seg_side]", "obs.proprio=true", "obs.frame_stack=2"]
    words += ["obs.privileged_facts=[grasped,lifted]", "image_size=16", "precision=fp32"]
    run_composed(composed(*words, "results=results"))
    run = "results/main/dep_front+seg_side+signals/sparse/seed0"
    capsys.readouterr()
    assert main(["export", "what=policy", f"run={run}"]) == 0
    assert "policy.onnx" in capsys.readouterr().out
    # All weights are in the one file.
    assert {path.name for path in Path().iterdir()} == {"results", "policy.onnx"}
    session = onnxruntime.InferenceSession("policy.onnx", providers=["CPUExecutionProvider"])
    policy = needlehoop.load_policy(run, device="cpu")
    for n in (1, 5):
        seen = needlehoop.make_env_of(run, num_envs=n).reset()
        flat = {**seen.to_dict(), **seen["pixels"].to_dict()}
        inputs = {node.name: flat[node.name].numpy() for node in session.get_inputs()}
        (action,) = session.run(None, inputs)
        assert action.shape == (n, 5)
        np.testing.assert_allclose(action, policy(seen).numpy(), atol=1e-5)
