"""What it makes who writes a reward, and whether with an image."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import ttest_rel
from study_files import PAIRS, REWARDED, write_run, write_study

from needlehoop.study.data.findings import study_findings
from needlehoop.study.report.table import Table
from needlehoop.study.stats.writers import writers

SETS = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")


def rows_of(table: Table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}


def rewrite(run, **numbers):
    path = run / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | numbers))


def threaded(run) -> float:
    """The mean success of all training episodes, by buffers, in percent."""
    with (run / "metrics.csv").open(newline="") as file:
        known = [float(row["success"]) for row in csv.DictReader(file) if row["success"]]
    return 100 * sum(known) / len(known)


def test_differences_are_paired_by_cameras(tmp_path):
    points: dict[str, list[float]] = {"human": [8.8, 8.7, 8.1], "vlm_text": [8.5, 6.0, 7.9]}
    soon: dict[str, list[float]] = {}
    for reward, own in points.items():
        for number, (cameras, value) in enumerate(zip(SETS, own, strict=True)):
            goal = value - (reward == "vlm_text")
            # Not called vlm_text while it is made: runs of that name never thread there.
            run = write_run(tmp_path / reward, cameras, goal=goal, noise=number)
            rewrite(run, return_human=value, success=value / 10, cheat=0.25)
            soon.setdefault(reward, []).append(threaded(run))
            to = tmp_path / "main" / cameras / reward
            to.parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / reward / cameras / "human").rename(to)
    rows = rows_of(writers(study_findings(tmp_path / "main")))
    assert set(rows) == {"VLM, text, against human"}
    (row,) = rows.values()
    for column, values, form in (
        ("human's points", points, "+.2f"),
        ("success, %", {name: 10 * np.array(own) for name, own in points.items()}, "+.0f"),
        ("threaded over training, %", soon, "+.0f"),
    ):
        found = ttest_rel(values["vlm_text"], values["human"])
        middle = np.mean(values["vlm_text"]) - np.mean(values["human"])
        low, high = found.confidence_interval(0.95)
        said = f"{middle:{form}} ({low:{form}} to {high:{form}})"
        assert row[f"{column}: difference (95 %)"] == said
    assert row["cheat, %: difference (95 %)"] == "+0 (+0 to +0)"
    assert row["pairs"] == "3"


def test_an_image_is_judged_by_all_who_wrote_with_and_without(tmp_path):
    study = tmp_path / "main"
    points = {
        "vlm_text": [3.0, 4.0],
        "vlm_img": [5.0, 7.0],
        "vlm_text_claude": [8.0],
        "vlm_img_claude": [7.0],
    }
    for reward, own in points.items():
        for cameras, value in zip(SETS, own, strict=False):
            rewrite(write_run(study, cameras, reward), return_human=value)
    rows = rows_of(writers(study_findings(study)))
    column = "human's points: difference (95 %)"
    assert {name: (row[column].split()[0], row["pairs"]) for name, row in rows.items()} == {
        "VLM, text + image, against text alone": ("+2.50", "2"),
        "claude, text + image, against text alone": ("-1.00", "1"),
        "an image, whoever writes": ("+1.33", "3"),
    }
    both, alone = "an image, whoever writes", "VLM, text + image, against text alone"
    low, high = ttest_rel([5, 7, 7], [3, 4, 8]).confidence_interval(0.95)
    assert rows[both][column] == f"+1.33 ({low:+.2f} to {high:+.2f})"
    # Two pairs are too few for an interval.
    assert "to" not in rows[alone][column]
    assert rows[alone]["cameras"] == "DEP (F) + RGB (S), DEP (F) + SEG (S)"


def test_a_seed_more_is_a_middle_and_not_a_pair_more(tmp_path):
    study = tmp_path / "main"
    for reward, own in {"human": [9.0], "vlm_text": [4.0, 6.0]}.items():
        for seed, value in enumerate(own):
            rewrite(write_run(study, SETS[0], reward, seed), return_human=value)
    (row,) = rows_of(writers(study_findings(study))).values()
    assert row["human's points: difference (95 %)"] == "-4.00"
    assert row["pairs"] == "1"


def test_what_a_run_does_not_say_is_not_compared(tmp_path):
    study = tmp_path / "main"
    rewrite(write_run(study, SETS[0]), return_human=8.0)
    write_run(study, SETS[0], "vlm_text", updates=60)
    (row,) = rows_of(writers(study_findings(study))).values()
    # Its evaluations are older than human points, and its training is not over.
    assert row["human's points: difference (95 %)"] == ""
    assert row["threaded over training, %: difference (95 %)"] == ""
    assert row["success, %: difference (95 %)"]


@pytest.mark.parametrize("pairs", [PAIRS, REWARDED[:1], [("rgb_default", "sparse"), PAIRS[0]]])
def test_without_two_such_rewards_there_is_no_table(tmp_path, pairs):
    assert writers(study_findings(write_study(tmp_path / "main", pairs, seeds=1))).rows == ()
