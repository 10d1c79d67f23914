"""Tables of the protocol's runs: what is added to them, and which seeds count."""

from __future__ import annotations

import pandas as pd
import pytest
import yaml
from study_files import change, write_run

from analysis.runs import DISTURB, add, runs_of, stress_of

STRESS = (
    "axis,severity,amount,unit,episodes,success\nnone,0,,,40,0.5\nrobot.late,3,2,steps,40,0.25\n"
)


def written(folder, cameras, seed, disturb="none", success=0.5, reward="human"):
    """A finished run as the protocol's are."""
    run = write_run(folder, cameras, reward, seed)
    evaluation = {"success_sampled": 0.5, "touched": 0.5, "success": success, "steps_trained": 100}
    change(run / "evaluation.json", **evaluation, grasped=0.5, lifted=0.5, **{"return": 5.0})
    change(run / "manifest.json", commit="abc", wall_time=90.0)
    amounts = yaml.safe_load((DISTURB / f"{disturb}.yaml").read_text())
    change(run / "config.yaml", disturb=amounts)
    return run


def test_a_seed_counts_once_all_camera_sets_have_it(tmp_path):
    for cameras, seeds in (("dep_front+seg_side", (0, 1)), ("rgb_front+rgb_side", (1, 2))):
        for seed in seeds:
            written(tmp_path / "main", cameras, seed)
    add(tmp_path / "kept", [tmp_path / "main"])
    runs = runs_of(tmp_path / "kept")
    assert runs["seed"].tolist() == [1, 1]
    assert runs["two_views"].all()
    assert runs["depth"].tolist() == runs["labels"].tolist() == [True, False]
    assert runs["minutes"].tolist() == [1.5, 1.5]


def test_a_run_that_is_there_stays_as_it_is(tmp_path):
    for study, success in (("first", 0.5), ("second", 0.75)):
        written(tmp_path / study, "rgb_default", 1, success=success)
        add(tmp_path / "kept", [tmp_path / study])
    assert runs_of(tmp_path / "kept")["success"].tolist() == [0.5]


def test_a_stress_test_counts_once_all_sets_have_one_of_its_seed(tmp_path):
    for disturb in ("none", "moderate"):
        for cameras in ("dep_default", "rgb_default"):
            for seed in (1, 2):
                run = written(tmp_path / disturb, cameras, seed, disturb)
                if seed == 1 or cameras == "rgb_default":
                    (run / "stress.csv").write_text(STRESS)
    add(tmp_path / "kept", [tmp_path / "none", tmp_path / "moderate"])
    assert len(pd.read_csv(tmp_path / "kept" / "stress.csv")) == 12
    stress = stress_of(tmp_path / "kept")
    assert {*stress["seed"]} == {1}
    assert stress.groupby(["disturb", "cameras", "axis"]).size().eq(1).all()
    assert stress["success"].mean() == pytest.approx(0.375)


def test_a_run_under_amounts_of_its_own_is_refused(tmp_path):
    run = written(tmp_path / "main", "rgb_default", 1)
    config = yaml.safe_load((run / "config.yaml").read_text())
    config["disturb"]["camera"]["shift"] = 0.005
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    with pytest.raises(ValueError, match=r"seed1: its disturb is none of mild, moderate, none"):
        add(tmp_path / "kept", [tmp_path / "main"])
    assert not (tmp_path / "kept").exists()
