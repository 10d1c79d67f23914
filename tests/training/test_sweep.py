"""Sweeps: what is missing is done, failures are told, launchers share the CPUs."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path

import pytest
import yaml
from tiny_runs import PLACE, composed, outcome, run_composed, run_train
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


def test_a_failed_run_stops_no_other_and_the_same_command_does_the_rest(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    # The file is in the way of the second run's folder.
    Path("results/main/signals/sparse").mkdir(parents=True)
    blocked = Path("results/main/signals/sparse/seed1")
    blocked.write_text("")
    words = ["-m", "seed=0,1,2", *TINY]
    with pytest.raises(SystemExit) as caught:
        run_train(*words)
    assert caught.value.code == "the same command, without overwrite=true, does what is missing"
    said = capfd.readouterr().out
    assert "3 runs, 1 failed" in said
    assert "seed=1 " in said.splitlines()[-1]
    assert main(["status", "results/main"]) == 0
    assert "signals/sparse/seed1  failed" in capfd.readouterr().out
    began = {seed: finished(seed)["started"] for seed in (0, 2)}

    blocked.unlink()
    run_train(*words)
    assert "3 runs, 0 failed, 2 done before" in capfd.readouterr().out
    assert finished(1)["finished"]
    for seed, when in began.items():
        assert finished(seed)["started"] == when


def test_a_run_with_other_settings_is_not_taken_for_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_composed(composed(*TINY))
    run_composed(composed(*TINY, "existing=resume", "engine.threads=2"))
    for words, said in (
        (
            ["existing=resume", "steps=128", "algo.gamma=0.5"],
            "exists with another algo, steps; choose another label= or",
        ),
        ([], "exists; go on with"),
        (["existing=skip"], "existing: 'skip' is unknown; choose from auto, stop, resume"),
    ):
        with pytest.raises(ValueError, match=said):
            run_composed(composed(*TINY, *words))


def test_a_run_that_stopped_before_its_first_checkpoint_begins_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = composed(*TINY, "existing=resume")
    run_composed(values)
    folder = Path("results/main/signals/sparse/seed0")
    (folder / "checkpoint.pt").unlink()
    manifest = {**finished(0), "finished": False, "started": "long ago"}
    # Noted with the first checkpoint.
    del manifest["steps"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    run_composed(values)
    again = finished(0)
    assert again["finished"]
    assert again["started"] != "long ago"


def test_runs_of_a_sweep_that_differ_have_folders_of_their_own(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    words = ["-m", *TINY, "algo.learning_rate=1e-4,3e-4", "task=near,wide"]
    run_train(*words)
    assert "4 runs, 0 failed" in capfd.readouterr().out
    places = {
        f"signals/sparse+algo.learning_rate-{rate}+task-{task}/seed0": (rate, task)
        for rate, task in product(("0.0001", "0.0003"), ("near", "wide"))
    }
    found = {str(run.place): run for run in read_study(Path("results/main")).runs}
    assert found.keys() == places.keys()
    for place, (rate, task) in places.items():
        own = compose_settings([f"task={task}"]).task.needle_yaw_range
        config = found[place].config
        assert (str(config["algo"]["learning_rate"]), config["label"]) == (
            rate,
            f"algo.learning_rate-{rate}+task-{task}",
        )
        assert config["task"]["needle_yaw_range"] == own
    assert main(["plot", "results/main"]) == 0
    capfd.readouterr()
    table = Path("results/main/tables/results.csv").read_text()
    assert "algo.learning_rate-0.0001+task-near" in table
    assert table.count("algo.learning_rate-0.0003") == 2
    # What they are called by does not depend on the order of the words.
    run_train("-m", *TINY, *reversed(words[-2:]))
    assert "4 runs, 0 failed, 4 done before" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("words", "params", "own", "label"),
    [
        ("cams=[a],[b] seed=0,1 study=x,y", {}, "cams=[a] seed=0 study=x", None),
        ("reward=human,sparse", {}, "reward=sparse", None),
        ("obs=images,signals", {}, "obs=signals", None),
        ("reward=mine,sparse", {}, "reward=mine", "reward-mine"),
        ("label=mine steps=64,128", {}, "label=mine steps=64", "mine+steps-64"),
        ("seed=0", {"image_size": "32,64"}, "image_size=32 seed=0", "image_size-32"),
        (
            "views.front.target=[0,0],[0,1]",
            {},
            "views.front.target=[0,1]",
            "views.front.target-_0_1",
        ),
    ],
)
def test_a_label_says_what_the_path_does_not(words, params, own, label):
    values = {"label": "mine" if "label=mine" in words else None}
    values |= {"algo": {}, "reward": {"kind": "sparse"}}
    assert sweep.label_of(values, words.split(), params, own.split()) == label


@cache
def swept(experiment: str) -> list[tuple[tuple[str, ...], str]]:
    """Cameras and reward of each run of an experiment."""
    values = yaml.safe_load((composing.CONF / "experiment" / f"{experiment}.yaml").read_text())
    params = values["hydra"]["sweeper"]["params"]
    runs = []
    cams = [text.strip(" []").split(",") for text in params["cams"].split("],")]
    for chosen, reward in product(cams, params.get("reward", "human").split(",")):
        runs.append((tuple(name.strip() for name in chosen), reward))
    return runs


def test_every_run_of_an_experiment_is_another_and_composes():
    runs = {name: swept(name) for name in ("table2", "rewards", "segdep")}
    assert [len(own) for own in runs.values()] == [14, 12, 4]
    assert all(len(set(own)) == len(own) for own in runs.values())
    for cams, reward in {run for own in runs.values() for run in own}:
        words = [f"cams=[{','.join(cams)}]", f"reward={reward}"]
        job = typed_job(composing.compose(words, "config"))
        assert (job.env.cams, job.reward_name) == (cams, reward)


def test_an_experiment_s_camera_sets_can_be_asked_about():
    own = ["+".join(cams) for cams, _ in swept("table2")]
    assert sweep.camera_sets("table2") == sorted(own)


def test_an_experiment_is_a_sweep_without_being_told(tmp_path, monkeypatch, capfd):
    """Down to the first run, which is in the way of all others."""
    monkeypatch.chdir(tmp_path)
    started: list[str] = []
    monkeypatch.setattr(sweep, "attempt", lambda run, folder, note: started.append(note["run"]))
    with pytest.raises(SystemExit):
        run_train("+experiment=segdep", "seed=3", *TINY[2:], "obs=images")
    assert len(started) == 4
    assert "4 runs, 4 failed" in capfd.readouterr().out


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


def test_a_job_says_which_run_it_is_as_the_study_reads_it():
    values = composing.compose(
        ["cams=dep_front", "obs=signals", "reward=sparse", "seed=3"], "config"
    )
    note = sweep.identity(values, ["seed=3"])
    place = f"{note['study']}/{note['cameras']}/{note['reward']}/seed{note['seed']}"
    assert place == typed_job(values).place == "main/dep_front+signals/sparse/seed3"


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


@pytest.mark.parametrize(
    "launcher",
    [
        pytest.param(["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"], id="joblib"),
        pytest.param(
            ["hydra/launcher=submitit_local", "hydra.launcher.cpus_per_task=1"],
            id="submitit",
            marks=pytest.mark.full,
        ),
        pytest.param(
            [
                "hydra/launcher=ray",
                "+hydra.launcher.ray.init.num_cpus=2",
                "+hydra.launcher.ray.remote.num_cpus=1",
                "+hydra.launcher.ray.init.include_dashboard=false",
            ],
            id="ray",
            marks=pytest.mark.full,
        ),
    ],
)
@pytest.mark.full
def test_a_launcher_runs_a_sweep(tmp_path, launcher):
    words = ["-m", "seed=0,1", *TINY, "engine.threads=0", *launcher]
    # Ray makes its workers yield to everything else; on a busy machine they would starve.
    surroundings = {**os.environ, "RAY_worker_niceness": "0", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, ROOT / "train.py", *words],
        cwd=tmp_path,
        env=surroundings,
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "2 runs, 0 failed" in done.stdout
    for seed in (0, 1):
        folder = tmp_path / f"results/main/signals/sparse/seed{seed}"
        assert json.loads((folder / "manifest.json").read_text())["finished"]
        assert yaml.safe_load((folder / "config.yaml").read_text())["engine"]["threads"] == 1


@pytest.mark.full
def test_two_sweeps_at_once_make_each_run_once(tmp_path):
    words = ["-m", *SMALL, "results=results", "seed=0,1,2", "steps=48"]
    command = [sys.executable, str(ROOT / "train.py"), *words]
    how = {"cwd": tmp_path, "text": True, "env": {**os.environ, "PYTHONPATH": str(ROOT)}}
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, **how) for _ in range(2)]
    said = [process.communicate(timeout=300)[0] for process in both]
    assert all("3 runs, 0 failed" in one for one in said), said
    for seed in range(3):
        rows = outcome(tmp_path / "results" / PLACE.replace("seed0", f"seed{seed}"))["metrics"]
        assert [row["update"] for row in rows] == [str(n) for n in range(1, 7)]
    assert not list((tmp_path / "results" / "main").rglob("*.partial"))
