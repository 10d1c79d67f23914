"""Searches for settings, by Optuna's sweeper for Hydra."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tiny_runs import TINY, refusal

from needlehoop.training import sweep

ROOT = Path(__file__).parents[2]
SEARCH = [
    *("-m", "hydra/sweeper=optuna", "hydra.sweeper.n_trials=2", "hydra.sweeper.sampler.seed=0"),
    *("algo.learning_rate=interval(1e-4,1e-3)", "objective=return_human", "evaluation.every=0"),
    "study=trial${hydra:job.num}",
]
"""Two trials, each in a study of its own."""


@pytest.mark.parametrize(
    "more",
    [
        [],
        pytest.param(["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"], marks=pytest.mark.full),
    ],
)
def test_a_search_finds_the_trial_with_the_highest_objective(tmp_path, more):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    words = [sys.executable, str(ROOT / "train.py"), *TINY, *SEARCH, *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    results = tmp_path / "results"
    (found,) = results.glob(".sweeps/*/optimization_results.yaml")
    trials = {}
    for folder in results.glob("trial*/signals/*/seed0"):
        rate = yaml.safe_load((folder / "config.yaml").read_text())["algo"]["learning_rate"]
        trials[rate] = json.loads((folder / "evaluation.json").read_text())["return_human"]
    assert len(trials) == 2
    best = yaml.safe_load(found.read_text())
    assert best["best_value"] == max(trials.values())
    assert trials[best["best_params"]["algo.learning_rate"]] == best["best_value"]
    assert "best_params" in done.stdout


def test_a_search_makes_its_objective_high_unless_told_otherwise():
    search = ["-m", "hydra/sweeper=optuna"]
    assert sweep.direction(search) == ["hydra.sweeper.direction=maximize"]
    assert sweep.direction([*search, "hydra.sweeper.direction=minimize"]) == []
    assert sweep.direction(["-m", "seed=0,1"]) == []


def test_an_objective_is_a_number_of_evaluations(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "objective: 'sucess' is unknown; choose from success, " in refusal(
        *TINY, "objective=sucess"
    )
    assert list(tmp_path.iterdir()) == []
