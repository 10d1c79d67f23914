"""Sweeps: what is missing is done, failures are told, launchers share the CPUs."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tiny_runs import PLACE, outcome, refusal, run_train
from tiny_runs import TINY as SMALL

from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.envs.settings import compose_settings
from needlehoop.learning.job import typed_job
from needlehoop.study.data.records import read_study
from needlehoop.training import sweep

ROOT = Path(__file__).parents[2]

TINY = [*SMALL, "steps=8", "evaluation.every=0", "results=results"]
"""One buffer."""


def finished(seed: int) -> dict:
    return json.loads(Path(f"results/main/signals/sparse/seed{seed}/manifest.json").read_text())


@pytest.fixture
def started(monkeypatch, elsewhere) -> list[str]:
    """The runs that were started, which do nothing, in a folder of their own."""
    runs: list[str] = []
    monkeypatch.setattr(sweep, "attempt", lambda run, folder, note: runs.append(note["run"]))
    return runs


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["cams=[seg_side],[dep_front]", "algo.minibatch=64,0"],
            "algo.minibatch: 0 must be at least 1",
        ),
        # Of the paper's 14 combinations, 3 have a program in its recording.
        (
            ["+experiment=table2", "reward=vlm_img", "study=s"],
            r"make one with: needlehoop vlm reward 'cams=\[rgb_default\]' flavour=image study=s",
        ),
    ],
)
def test_a_mistake_in_one_run_stops_all(started, tmp_path, words, message):
    with pytest.raises(SystemExit, match=f"nothing was started: .*{message}") as caught:
        run_train("-m", *words)
    assert "\n" not in str(caught.value.code)
    assert started == list(tmp_path.iterdir()) == []


def test_an_experiment_is_a_sweep_without_being_told(started, capfd):
    """Down to the first run, which is in the way of all others."""
    with pytest.raises(SystemExit):
        run_train("+experiment=segdep", "seed=3", *TINY[2:], "obs=images")
    assert len(started) == 4
    assert "4 runs, 4 failed" in capfd.readouterr().out


def test_every_run_of_an_experiment_is_another_and_composes():
    for name, count in (("table2", 14), ("rewards", 12), ("segdep", 4)):
        params = composing.swept([f"+experiment={name}"])
        runs = sweep.combinations(f"{key}={value}" for key, value in params.items())
        jobs = [typed_job(composing.compose(words, "config")) for words in runs]
        assert len({(job.env.cams, job.reward_name) for job in jobs}) == count
        assert {"+".join(job.env.cams) for job in jobs} == {*sweep.camera_sets(name)}


def test_a_failed_run_stops_no_other_and_the_same_command_does_the_rest(elsewhere, capfd):
    # The file is in the way of the second run's folder.
    Path("results/main/signals/sparse").mkdir(parents=True)
    blocked = Path("results/main/signals/sparse/seed1")
    blocked.write_text("")
    words = ["-m", "seed=0,1,2", *TINY]
    with pytest.raises(SystemExit) as caught:
        run_train(*words)
    assert caught.value.code == "the same command, without overwrite=true, does what is missing"
    output = capfd.readouterr().out
    assert "3 runs, 1 failed" in output
    assert "seed=1 " in output.splitlines()[-1]
    assert main(["status", "results/main"]) == 0
    assert "signals/sparse/seed1  failed" in capfd.readouterr().out
    began = {seed: finished(seed)["started"] for seed in (0, 2)}

    blocked.unlink()
    run_train(*words)
    assert "3 runs, 0 failed, 2 done before" in capfd.readouterr().out
    assert finished(1)["finished"]
    assert {seed: finished(seed)["started"] for seed in (0, 2)} == began


def test_runs_of_a_sweep_that_differ_have_folders_of_their_own(elsewhere, capfd):
    words = ["-m", *TINY, "algo.learning_rate=1e-4", "task=near,wide"]
    run_train(*words)
    assert "2 runs, 0 failed" in capfd.readouterr().out
    runs = {str(run.place): run.config for run in read_study(Path("results/main")).runs}
    for task in ("near", "wide"):
        config = runs.pop(f"signals/sparse+task-{task}/seed0")
        yaw_range = compose_settings([f"task={task}"]).task.needle_yaw_range
        assert config["algo"]["learning_rate"] == 1e-4
        assert config["task"]["needle_yaw_range"] == yaw_range
    assert not runs
    run_train(*words)
    assert "2 runs, 0 failed, 2 done before" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("words", "params", "overrides", "label"),
    [
        ("cams=[a],[b] seed=0,1 study=x,y", {}, "cams=[a] seed=0 study=x", None),
        ("obs=images,signals", {}, "obs=signals", None),
        ("reward=human,sparse", {}, "reward=sparse", None),
        ("reward=mine,sparse", {}, "reward=mine", "reward-mine"),
        ("label=mine steps=64,128", {}, "label=mine steps=64", "mine+steps-64"),
        # Not in the order of the words.
        ("steps=1,2 algo.gamma=0,1", {}, "steps=2 algo.gamma=0", "algo.gamma-0+steps-2"),
        ("seed=0", {"image_size": "32,64"}, "image_size=32 seed=0", "image_size-32"),
        ("views.a.target=[0,0],[0,1]", {}, "views.a.target=[0,1]", "views.a.target-_0_1"),
    ],
)
def test_a_label_says_what_the_path_does_not(words, params, overrides, label):
    values = {"label": "mine" if "label=mine" in words else None}
    values |= {"algo": {}, "reward": {"kind": "sparse"}}
    assert sweep.label_of(values, words.split(), params, overrides.split()) == label


def test_a_stopped_run_is_noted_and_stops_the_sweep(tmp_path):
    for job in ("0", "1", "2", "10"):
        (tmp_path / job).mkdir()
    sweep.attempt(lambda: ("done before", 0.5), tmp_path / "0", {"run": "seed=0"})
    with pytest.raises(KeyboardInterrupt):
        sweep.attempt(lambda: ("stopped", math.nan), tmp_path / "1", {"run": "seed=1"})
    # Killed before, and while, it wrote its note.
    (tmp_path / "10" / "outcome.json").write_text('{"run": ')
    lines, failed = sweep.summary(tmp_path)
    assert failed == 2
    assert lines == [
        "4 runs, 2 failed, 1 done before",
        f"  {tmp_path / '2'}: it was killed",
        f"  {tmp_path / '10'}: it was killed",
    ]


@pytest.mark.parametrize(
    ("launcher", "expected"),
    [
        ({}, 0),
        ({"n_jobs": 4}, 2),
        ({"n_jobs": -5}, 2),
        ({"cpus_per_task": 3}, 3),
        ({"ray": {"remote": {"num_cpus": 2}}}, 2),
    ],
)
def test_threads_are_divided_among_jobs(launcher, expected, monkeypatch):
    monkeypatch.setattr(sweep, "available_cpus", lambda: 8)
    assert sweep.threads(launcher) == expected


def started_as(words: list[str], folder: Path) -> subprocess.Popen[str]:
    """``python train.py`` in a process of its own."""
    # Ray makes its workers yield to everything else; on a busy machine they would starve.
    surroundings = {**os.environ, "RAY_worker_niceness": "0", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / "train.py"), *words]
    return subprocess.Popen(
        command, cwd=folder, env=surroundings, stdout=subprocess.PIPE, text=True
    )


RAY = ("hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2")
RAY += ("+hydra.launcher.ray.remote.num_cpus=1", "+hydra.launcher.ray.init.include_dashboard=false")


@pytest.mark.parametrize(
    "launcher",
    [
        pytest.param(("hydra/launcher=joblib", "hydra.launcher.n_jobs=2"), id="joblib"),
        pytest.param(
            ("hydra/launcher=submitit_local", "hydra.launcher.cpus_per_task=1"), id="submitit"
        ),
        pytest.param(RAY, id="ray"),
    ],
)
@pytest.mark.full
def test_a_launcher_runs_a_sweep(tmp_path, launcher):
    process = started_as(["-m", "seed=0,1", *TINY, "engine.threads=0", *launcher], tmp_path)
    output, _ = process.communicate(timeout=280)
    assert process.returncode == 0
    assert "2 runs, 0 failed" in output
    for seed in (0, 1):
        folder = tmp_path / f"results/main/signals/sparse/seed{seed}"
        assert json.loads((folder / "manifest.json").read_text())["finished"]
        assert yaml.safe_load((folder / "config.yaml").read_text())["engine"]["threads"] == 1


@pytest.mark.full
def test_two_sweeps_at_once_make_each_run_once(tmp_path):
    words = ["-m", *SMALL, "results=results", "seed=0,1,2", "steps=48"]
    both = [started_as(words, tmp_path) for _ in range(2)]
    outputs = [process.communicate(timeout=300)[0] for process in both]
    assert all("3 runs, 0 failed" in output for output in outputs), outputs
    for seed in range(3):
        rows = outcome(tmp_path / "results" / PLACE.replace("seed0", f"seed{seed}"))["metrics"]
        assert [row["update"] for row in rows] == [str(n) for n in range(1, 7)]
    assert not list((tmp_path / "results" / "main").rglob("*.partial"))


@pytest.mark.full
def test_a_search_finds_the_trial_with_the_highest_objective(tmp_path):
    """By Optuna's sweeper for Hydra; two trials, each in a study of its own."""
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    words = ["-m", "hydra/sweeper=optuna", "hydra.sweeper.n_trials=2"]
    words += ["hydra.sweeper.sampler.seed=0", "algo.learning_rate=interval(1e-4,1e-3)"]
    words += ["objective=return_human", "study=trial${hydra:job.num}"]
    process = started_as([*TINY, *words], tmp_path)
    output, _ = process.communicate(timeout=280)
    assert process.returncode == 0
    (file,) = (tmp_path / "results").glob(".sweeps/*/optimization_results.yaml")
    trials = {}
    for folder in (tmp_path / "results").glob("trial*/signals/*/seed0"):
        rate = yaml.safe_load((folder / "config.yaml").read_text())["algo"]["learning_rate"]
        trials[rate] = json.loads((folder / "evaluation.json").read_text())["return_human"]
    assert len(trials) == 2
    best = yaml.safe_load(file.read_text())
    assert best["best_value"] == max(trials.values())
    assert trials[best["best_params"]["algo.learning_rate"]] == best["best_value"]
    assert "best_params" in output


def test_an_objective_is_a_number_of_evaluations():
    assert "objective: 'sucess' is unknown; choose from success, " in refusal(
        *TINY, "objective=sucess"
    )
