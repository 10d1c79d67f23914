"""``needlehoop export what=policy``: a policy as ONNX, which acts as torch's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tiny_runs import TINY, composed, run_composed

import needlehoop
from needlehoop.cli.main import main

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")

OWN = {
    "signals": [],
    "dep_front+seg_side": [
        "cams=[dep_front,seg_side]",
        "obs=images",
        "obs.proprio=true",
        "obs.told=[grasped,lifted]",
        "obs.frame_stack=2",
        "image_size=16",
        "precision=fp32",
    ],
}


@pytest.mark.parametrize("seen", OWN)
def test_a_policy_in_onnx_acts_as_in_torch(seen, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_composed(composed(*TINY, *OWN[seen], "results=results"))
    run = f"results/main/{seen}/sparse/seed0"
    capsys.readouterr()
    assert main(["export", "what=policy", f"run={run}"]) == 0
    assert "policy.onnx" in capsys.readouterr().out
    # All weights are in the one file.
    assert {path.name for path in Path().iterdir()} == {"results", "policy.onnx"}
    session = onnxruntime.InferenceSession("policy.onnx", providers=["CPUExecutionProvider"])
    policy = needlehoop.load_policy(run, device="cpu")
    for n in (1, 5):
        observation = needlehoop.make_env_of(run, num_envs=n).reset()
        given = {
            one.name: (
                observation["pixels", one.name]
                if one.name in seen.split("+") and one.name != "signals"
                else observation[one.name].float()
            ).numpy()
            for one in session.get_inputs()
        }
        (action,) = session.run(None, given)
        assert action.shape == (n, 5)
        np.testing.assert_allclose(action, policy(observation).numpy(), atol=1e-5)
