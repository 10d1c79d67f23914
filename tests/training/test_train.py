"""The main job: command lines, the run's folder, stopping and going on, evaluation."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from tiny_runs import TINY as SIGNALS
from tiny_runs import composed, contents, outcome, run_composed, run_train, table

from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.pictures import film
from needlehoop.study.data.records import read_study

ROOT = Path(__file__).parents[2]

TINY = [
    "steps=192",
    "num_envs=4",
    "algo.horizon=16",
    "algo.minibatch=32",
    "image_size=32",
    "episode.max_steps=12",
    "evaluation.every=2",
    "evaluation.episodes=2",
    "evaluation.final_episodes=3",
    "evaluation.video_episodes=0",
    "checkpoint_every=1",
    "engine.threads=1",
]
"""Three buffers of 64 steps."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """The folder of a run of the issue's first command line, left alone until its end."""
    results = tmp_path_factory.mktemp("whole")
    words = ["cams=dep_front,seg_side", "reward=human", *TINY, "obs.frame_stack=2"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(results)
        run_train(*words, "results=.", "obs.proprio=true", "evaluation.video_episodes=1")
    return results / "main/dep_front+seg_side/human/seed0"


def test_a_sweep_pauses_all_its_runs_and_each_goes_on_to_the_same_end(tiny_run, elsewhere, capsys):
    words = ["-m", "seed=0,1", *SIGNALS, "checkpoint_every=5"]
    run_train(*words, "until=9")
    output = capsys.readouterr().out
    assert "2 runs, 0 failed, 2 paused" in output
    assert "paused; go on with: python train.py resume=results/main/signals/sparse/seed1" in output
    folders = [Path(f"results/main/signals/sparse/seed{seed}") for seed in (0, 1)]
    for folder in folders:
        manifest = json.loads((folder / "manifest.json").read_text())
        assert (manifest["steps"], manifest["stopped"], manifest["finished"]) == (16, True, False)
    # What is typed for one session binds no other.
    run_train(f"resume={folders[0]}")
    assert outcome(folders[0]) == outcome(tiny_run)
    run_train(*words)
    assert "2 runs, 0 failed, 1 done before" in capsys.readouterr().out


def test_a_run_is_a_folder_of_plain_files(finished):
    assert {path.name for path in finished.iterdir()} == {
        "config.yaml",
        "manifest.json",
        "reward.txt",
        "metrics.csv",
        "evaluations.csv",
        "evaluation.json",
        "checkpoint.pt",
        "policy.safetensors",
        "best.safetensors",
        "video.mp4",
    }
    manifest = json.loads((finished / "manifest.json").read_text())
    assert manifest["finished"] is True
    assert manifest["steps"] == 192
    assert manifest["versions"]["torch"] == torch.__version__
    assert "class Human" in (finished / "reward.txt").read_text()
    rows = table(finished / "metrics.csv")
    assert [row["step"] for row in rows] == ["64", "128", "192"]
    promised = "return success touched cheat grasped lifted length loss_policy loss_value kl"
    promised += " clip_fraction explained_variance entropy learning_rate term_grasp term_lift"
    promised += " term_hoop term_closed term_time"
    assert [name for name in promised.split() if not rows[-1].get(name)] == []
    terms = sum(float(value) for name, value in rows[-1].items() if name.startswith("term_"))
    assert terms == pytest.approx(float(rows[-1]["return"]), abs=1e-5)
    assert [row["step"] for row in table(finished / "evaluations.csv")] == ["128"]


def weights(run: Path) -> dict[str, torch.Tensor]:
    return torch.load(run / "checkpoint.pt")["learner"]["ppo"]["agent"]


@pytest.mark.parametrize(
    ("sent", "command"),
    [
        pytest.param(signal.SIGINT, ["-m", "needlehoop.cli.main", "train"], marks=pytest.mark.full),
        (signal.SIGKILL, [str(ROOT / "train.py")]),
    ],
)
def test_a_stopped_run_goes_on_to_the_same_bits(finished, tmp_path, sent, command):
    folder = tmp_path / "main/dep_front+seg_side/human/seed0"
    words = ["cams=dep_front,seg_side", *TINY, "obs.frame_stack=2"]
    words += ["obs.proprio=true", f"results={tmp_path}", "evaluation.video_episodes=1"]
    process = subprocess.Popen(
        [sys.executable, *command, *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # Stopped for good at the first checkpoint, however fast the machine.
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    while not (folder / "checkpoint.pt").exists() and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(sent)
    printed = process.communicate(timeout=120)[0].decode()
    if sent == signal.SIGINT:
        assert process.returncode == 0
        assert f"go on with: needlehoop train resume={folder}" in printed
    assert len(table(folder / "metrics.csv")) < 3

    run_train(f"resume={folder}")
    values = (finished / "config.yaml").read_text()
    assert (folder / "config.yaml").read_text() == values.replace(
        "results: .", f"results: {tmp_path}"
    )
    for name in ("metrics.csv", "evaluations.csv"):
        assert table(folder / name) == table(finished / name)
    for name in ("evaluation.json", "video.mp4"):
        assert (folder / name).read_bytes() == (finished / name).read_bytes()
    whole, resumed = weights(finished), weights(folder)
    assert all(torch.equal(whole[name], resumed[name]) for name in whole)


def test_two_runs_are_never_mixed(finished, monkeypatch):
    before = contents(finished)
    monkeypatch.chdir(finished.parents[3])
    words = ["cams=dep_front,seg_side", *TINY, "results=."]
    for wrong, message in (
        (words, "resume="),
        ([f"resume={finished}"], "finished"),
        ([f"resume={finished}", "steps=384"], "begin a run with its agent: init="),
        ([f"resume={finished.parent}"], "no run"),
    ):
        with pytest.raises(SystemExit) as caught:
            run_train(*wrong)
        assert message in str(caught.value.code)
    assert contents(finished) == before


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([], ["cams", "at least one camera", "segdep"]),
        (["cams=dep_front,rgb_top"], ["cams/rgb_top", "dep_default dep_ecm_left"]),
        (["cams=rgb_front", "image_size=22"], ["image_size", "22", "strided_s4d"]),
        (["cams=rgb_front", "+algo.network.squash=true"], ["algo.network.squash", "algo=sac"]),
    ],
)
def test_a_mistake_stops_before_anything_is_made(elsewhere, words, parts):
    with pytest.raises(SystemExit) as caught:
        run_train(*words)
    message = str(caught.value.code)
    assert [part for part in parts if part not in message] == []
    assert "\n" not in message
    assert list(elsewhere.iterdir()) == []


def test_the_shell_completes_cameras(monkeypatch, capsys):
    monkeypatch.setenv("COMP_LINE", "python train.py seed=1 cams=segdep_f")
    run_train("-sc", "query=bash")
    assert capsys.readouterr().out.split() == ["cams=segdep_front"]


def test_the_papers_setting():
    job = typed_job(composing.compose(["+experiment=paper", "cams=[seg_side]"], "config"))
    assert (job.buffer, job.env.num_envs, job.env.episode.success) == (10_240, 8, "touch")
    assert (job.algo.network.privileged_facts, job.encoder.name) == ((), "resnet")


def test_a_program_that_the_gates_object_to_is_trained_on_and_said_so(elsewhere, capsys):
    (elsewhere / "never.txt").write_text("reward = 20")
    words = [word for word in SIGNALS if not word.startswith("reward=")]
    run_train(*words, "reward=file", "reward.path=never.txt", "results=.")
    against = "refused, rises to 20.000; the most allowed is 9 and a bonus of 2"
    assert f"reward: the gates on this program: {against}" in capsys.readouterr().err
    manifest = json.loads((elsewhere / "main/signals/file/seed0/manifest.json").read_text())
    assert against in manifest["gates"]


@pytest.mark.full
def test_a_run_stopped_while_it_is_filmed_leaves_no_half_and_goes_on(elsewhere, monkeypatch):
    words = [*TINY, "evaluation.video_episodes=1"]
    frame = film._frame

    def stopped(*seen):
        os.kill(os.getpid(), signal.SIGTERM)
        return frame(*seen)

    with monkeypatch.context() as patch:
        patch.setattr(film, "_frame", stopped)
        run_train("cams=[seg_side]", *words, "results=.")
    run = elsewhere / "main/seg_side/human/seed0"
    assert not list(run.glob("video*"))
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["stopped"]
    assert not manifest.get("finished")
    run_train(f"resume={run}")
    assert (run / "video.mp4").exists()
    assert json.loads((run / "manifest.json").read_text())["finished"]


TAUGHT = ["cams=[seg_side]", "algo=dagger", *TINY, "algo.minibatches=3"]


@pytest.fixture(scope="module")
def imitated(tmp_path_factory) -> Path:
    """The folder of a run that an expert taught."""
    results = tmp_path_factory.mktemp("taught")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(results)
        run_train(*TAUGHT, "results=.")
    return results / "main/seg_side/expert/seed0"


def test_an_imitated_run_is_a_run_like_any_other(imitated):
    (run,) = read_study(imitated.parents[2]).runs
    assert str(run.place) == "seg_side/expert/seed0"
    assert run.finished
    assert run.evaluation["episodes"] == 3
    rows = table(imitated / "metrics.csv")
    assert [row["step"] for row in rows] == ["64", "128", "192"]
    assert all(float(row["error"]) > 0 for row in rows)
    # The expert flew all of the first buffer: the learner ended no episode.
    assert rows[0]["episodes"] == "0"
    assert rows[0]["success"] == ""
    assert int(float(rows[-1]["episodes"])) > 0


def test_a_run_begins_with_another_runs_agent(imitated, elsewhere):
    """Warming up, the value head moves and nothing else; then the policy does."""
    words = ["cams=[seg_side]", *TINY, f"init={imitated}", "algo.warmup=2", "algo.finetune=0.1"]
    before = torch.load(imitated / "checkpoint.pt")["learner"]["dagger"]["agent"]
    run = Path("main/seg_side/human/seed0")

    def changed() -> set[str]:
        now = weights(run)
        return {name for name in now if not torch.equal(now[name], before[name])}

    run_train(*words, "results=.", "until=128")
    assert {name.partition(".")[0] for name in changed()} == {"value"}
    run_train(f"resume={run}")
    assert "actor.head.mean.weight" in changed()
    # The schedule's thirds; gently, once the policy moves.
    rates = [float(row["learning_rate"]) for row in table(run / "metrics.csv")]
    assert rates == pytest.approx([3e-4, 2e-4, 1e-5])


def test_an_agent_of_other_networks_is_refused(imitated, elsewhere):
    for words, message in (
        (["cams=[rgb_side]"], "has cams=('seg_side',); this run has ('rgb_side',)"),
        (["cams=[seg_side]", "algo.network.hidden=64"], "made for network HeadConfig(hidden=256"),
        (["cams=[seg_side]", "image_size=64"], "made for image_size 32, and this is 64"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            run_composed(composed(*TINY, *words, f"init={imitated}", "results=."))
    assert not (elsewhere / "main").exists()
