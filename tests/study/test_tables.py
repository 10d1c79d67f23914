"""Tables: what is in them, and how numbers are written."""

import json

import numpy as np
import pandas as pd
import pytest
from study_files import PAIRS, REWARDED, change, rows_of, write_answers, write_run, write_study

from needlehoop.study.data.answers import LESS
from needlehoop.study.data.paper import reward_label
from needlehoop.study.render.table import Table, p_value, percent, written
from needlehoop.study.report.tables import (
    agreements,
    results,
    stress,
    table_1,
    table_2,
)
from needlehoop.study.stats.findings import StudyFindings, study_findings
from needlehoop.study.stats.run import BEST, SUCCESS_OVER_TRAINING
from needlehoop.study.stats.statistics import Estimated, Interval

PROBE = (
    "place,cameras,score\n1,rgb_front+dep_side,0.8\n2 to 3,rgb_front+rgb_side,0.7\n"
    "2 to 3,dep_front+rgb_side,0.7\n4,rgb_default+dep_default,0.6\n"
    "5,rgb_default,0.5\n,constant,0.0\n"
)


@pytest.fixture(scope="module")
def findings(tmp_path_factory) -> StudyFindings:
    folder = tmp_path_factory.mktemp("results") / "main"
    write_study(folder, [*PAIRS, *REWARDED], seeds=3)
    write_answers(folder)
    return study_findings(folder)


def test_numbers_become_text():
    whole = Interval(0.1, 0.25, over_episodes=True)
    for cell, text in (
        (None, ""),
        ("a remark", "a remark"),
        (1.005, "+1.00"),
        (float("nan"), "undefined"),
        (Estimated(1.0, Interval(-0.5, 2.0)), "+1.00 (-0.50 to +2.00)"),
        (whole, "+0.10 to +0.25 (over episodes)"),
        ([1.0, "not reached"], "+1.00, not reached"),
    ):
        assert written(cell, "+.2f") == text
    assert percent([0.5, 1]) == "50, 100"
    assert (p_value(0.0123), p_value(0.00123), p_value(None)) == ("0.01", "0.001", "")


def test_a_table_is_written_as_csv_and_markdown_and_removed_without_rows(tmp_path):
    table = Table.of("t", "A title", [{"a, b": "1", "c": "x"}], "A note.")
    assert [path.name for path in table.write(tmp_path)] == ["t.csv", "t.md"]
    assert (tmp_path / "t.csv").read_text() == '"a, b",c\n1,x\n'
    assert (tmp_path / "t.md").read_text() == (
        "**A title**\n\n| a, b | c |\n|---|---|\n| 1 | x |\n\nA note.\n"
    )
    assert table.text() == "A title\na, b    c\n1       x\nA note."
    assert Table.of("t", "A title", []).write(tmp_path) == []
    assert [*tmp_path.iterdir()] == []


def test_results_are_in_order_reward_by_reward(findings):
    rows = rows_of(results(findings))
    assert len(rows) == len(findings.results)
    images = ["VLM, text"] * 3 + ["VLM, text + image"] * 3
    assert [row["reward"] for row in rows] == ["human"] * 14 + images
    for reward in {row["reward"] for row in rows}:
        returns = [float(row["return"]) for row in rows if row["reward"] == reward]
        assert returns == sorted(returns, reverse=True)
    assert rows[3]["M steps to 90 %"] == "not reached, 0.62, not reached"
    known = {(one.cameras, reward_label(one.reward)): one for one in findings.results}
    for row in rows:
        finals = known[row["cameras"], row["reward"]].finals
        for column, measure, unit in (
            ("return", "return", 1),
            ("success, %", "success", 100),
            ("success at best, %", BEST, 100),
            ("success over training, %", SUCCESS_OVER_TRAINING, 100),
        ):
            mean = unit * np.mean([one.measures[measure] for one in finals])
            assert float(row[column]) == pytest.approx(mean, abs=0.0051 * unit)
        lifted = 100 * np.mean([one.measures["lifted"] for one in finals])
        assert float(row["lifted, %"]) == pytest.approx(lifted, abs=0.51)


def test_table_2_sets_ours_beside_the_papers(findings):
    rows = rows_of(table_2(findings))
    assert len(rows) == 16
    first = rows[0]
    assert (first["list"], first["cameras"]) == ("RGB and depth", "dep_front+rgb_side")
    assert (first["measured"], first["the paper's measured"]) == ("1", "1")
    assert (first["the paper's return"], first["the paper's VLM"]) == ("8.92", "1")
    for name in ("RGB and depth", "RGB and segmentation", "Depth and segmentation"):
        part = sorted((row for row in rows if row["list"] == name), key=lambda row: row["measured"])
        assert [row["measured"] for row in part] == [str(i + 1) for i in range(len(part))]
        returns = [float(row["return"]) for row in part]
        assert returns == sorted(returns, reverse=True)


def test_rankings_stand_side_by_side(tmp_path):
    study = write_study(tmp_path / "main", [("rgb_default", "human")], seeds=1)
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "ranking.csv").write_text(PROBE)
    table = table_2(study_findings(study))
    sources = ("the paper's VLM", "claude", "probe", "measured", "return over training")
    sources += ("the paper's measured",)
    variants = [f"claude, {how}" for how in LESS]
    numbers = ("return", "return, 95 %", "success, %", "the paper's return")
    assert (*table.rows,) == ("list", "cameras", *numbers, *sources[:2], *variants, *sources[2:])
    rows = {(row["list"], row["cameras"]): row for row in rows_of(table)}
    best = rows["RGB and depth", "dep_front+rgb_side"]
    # Claude's first is the paper's second; the probe's tie shares its mean place.
    assert [best[name] for name in sources] == ["1", "2", "2.5", "", "", "1"]
    assert best["return, 95 %"] == "not run"
    assert rows["RGB and depth", "rgb_default"]["measured"] == "1 of 1"
    # The probe has not seen all of the other lists.
    assert rows["Depth and segmentation", "dep_front+seg_side"]["probe"] == ""
    fits = rows_of(agreements(study_findings(study)))
    assert ("probe", "the paper's measured") in {
        (row["prediction"], row["against"]) for row in fits
    }
    assert "4 of 5 not measured" in {row["regret"] for row in fits}


def test_agreement_is_given_for_each_pair_of_sides(findings):
    rows = rows_of(agreements(findings))
    # Of the paper's VLM, claude, claude asked in three other ways and the paper's measured, by
    # final return and over training, and of the models in the paper; the study's own VLM has the
    # paper's orders, and is the paper's.
    assert len(rows) == ((5 + 1) * 2 + 5) * (3 + 1)
    papers = ("the paper's VLM", "the paper's measured")
    *alone, together = [row for row in rows if (row["prediction"], row["against"]) == papers]
    assert [(r["tau-b"], r["best found"], r["worst found"]) for r in alone] == [
        ("0.60", "yes", "yes")
    ] * 3
    assert together["list"] == "all lists"
    assert (together["tau-b"], together["best found"]) == ("0.60", "3 of 3")
    # No list alone rules chance out; together they do.
    assert min(float(row["p of tau-b"]) for row in alone) > 0.1
    assert float(together["p of tau-b"]) == pytest.approx(0.007, abs=0.003)


def test_table_1_has_the_models_answers_side_by_side(findings):
    rows = {row["question"]: row for row in rows_of(table_1(findings))}
    row = rows["Best view for subtask 2"]
    assert [row[source] for source in ("test-model", "claude", "the paper's VLM")] == ["side"] * 3


def test_a_study_of_another_task_says_nothing_of_the_paper(tmp_path):
    path = write_run(tmp_path, "rgb_default") / "manifest.json"
    change(path, task=json.loads(path.read_text())["task"] | {"name": "reach"})
    findings = study_findings(tmp_path)
    assert not findings.is_papers
    for table in (table_1, table_2, agreements):
        assert table(findings).rows.empty


def test_disturbances_are_summed_up_over_axes_and_runs(tmp_path):
    for cameras, shares in (("dep_default", (0.6, 0.8)), ("rgb_default", (0.2, 0.4))):
        for seed, share in enumerate(shares):
            run = write_run(tmp_path, cameras, seed=seed, updates=20, steps=204_800)
            conditions = [("none", 0, 1.0), ("camera.shift", 1, 0.9), ("camera.shift", 3, share)]
            conditions += [("robot.late", 3, 0.5), ("all", 3, 0.1)]
            tests = pd.DataFrame(conditions, columns=["axis", "severity", "success"])
            tests.assign(episodes=100).to_csv(run / "stress.csv", index=False)
    best, worst = rows_of(stress(study_findings(tmp_path)))
    assert (best["cameras"], worst["cameras"]) == ("dep_default", "rgb_default")
    assert (best["undisturbed, %"], best["all at once, %"]) == ("100", "10")
    # Shift 70 and late 50, over 400 episodes.
    assert best["severity 3, %"] == "60 (55 to 65 (over episodes))"
    assert best["hurts most"] == "robot.late 50 %, camera.shift 70 %"
    assert worst["hurts most"] == "camera.shift 30 %, robot.late 50 %"


def test_predictions_are_held_against_the_commonest_reward(tmp_path):
    sets = ["rgb_default", "rgb_default+dep_default", "rgb_front+rgb_side", "rgb_front+dep_side"]
    pairs = [(cameras, "expert") for cameras in (*sets, "dep_front+rgb_side")]
    findings = study_findings(write_study(tmp_path / "main", pairs, seeds=2))
    assert findings.main_reward == "expert"
    rows = rows_of(agreements(findings))
    assert ("claude", "measured") in {(r["prediction"], r["against"]) for r in rows if r["tau-b"]}
