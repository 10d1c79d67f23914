"""``needlehoop export what=policy``: a policy as ONNX, which acts as torch's."""

from __future__ import annotations

import sys
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
    assert main(["export", "what=policy", "format=onnx", f"run={run}"]) == 0
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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["what=policy", "format=tflite"], "written as onnx"),
        (["what=arm", "format=onnx"], "written as mjcf"),
        (["what=scene", "run=results"], "run: what=scene"),
        (["what=policy", "out=policy.pt"], ".onnx"),
        (["what=policy", "out=here.onnx"], "overwrite=true"),
        (["what=policy", "run=nowhere"], "nowhere"),
        (["what=agent"], "arm, scene, policy"),
    ],
)
def test_what_cannot_be_exported_is_refused(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("here.onnx").write_text("precious")
    assert main(["export", *words]) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["here.onnx"]


def test_without_the_exporter_the_extra_is_named(tiny_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    assert main(["export", "what=policy", f"run={tiny_run}"]) == 2
    assert "needlehoop[onnx]" in capsys.readouterr().err
    assert not Path("policy.onnx").exists()
