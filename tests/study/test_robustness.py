from __future__ import annotations

from pathlib import Path

import pytest
from study_files import write_study

from needlehoop.study.render.curves import MissingDataError
from needlehoop.study.render.figures import stress_figure
from needlehoop.study.report import tables
from needlehoop.study.stats.findings import robustness, study_findings

PAIRS = (("dep_front+seg_side", "human"), ("rgb_default", "human"))
HEAD = "axis,severity,amount,unit,episodes,success"


def lines(turn: float, shift: float) -> str:
    rows = ["none,0,,,100,1.0", f"camera.turn,1,0.2,degrees,100,{(1 + turn) / 2}"]
    rows += [f"camera.turn,3,1.0,degrees,100,{turn}", f"camera.shift,3,0.005,m,100,{shift}"]
    return "\n".join([HEAD, *rows, "all,3,,,100,0.1", ""])


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = write_study(tmp_path / "mine", PAIRS, seeds=1)
    for cameras, turn, shift in (("dep_front+seg_side", 0.2, 0.6), ("rgb_default", 0.9, 0.7)):
        (folder / cameras / "human/seed0/stress.csv").write_text(lines(turn, shift))
    return folder


def test_the_table_has_the_mean_over_axes_and_the_worst_first(study):
    rows = tables.stress(study_findings(study)).texts
    assert [row[:4] for row in rows] == [
        ("rgb_default", "100", "80 (74 to 85 (over episodes))", "10"),
        ("dep_front+seg_side", "100", "40 (33 to 47 (over episodes))", "10"),
    ]
    assert rows[1][4:] == ("camera.turn 20 %, camera.shift 60 %", "2", "1")


def test_the_figure_has_a_panel_for_each_axis_that_costs_something(study):
    figure = stress_figure(study_findings(study))
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title(loc="left") for axes in shown] == ["camera.turn", "camera.shift"]
    best = shown[0].lines[0]
    assert best.get_label() == "rgb_default"
    assert best.get_xydata().tolist() == [[0, 1.0], [1, 0.95], [3, 0.9]]


def test_runs_that_differ_in_a_setting_are_told_apart(study):
    own = study / "rgb_default/human"
    own.rename(own.with_name("human+disturb-moderate"))
    names = [row[0] for row in tables.stress(study_findings(study)).texts]
    assert names == ["rgb_default, disturb-moderate", "dep_front+seg_side"]


def test_without_a_stress_test_there_is_neither(tmp_path):
    findings = study_findings(write_study(tmp_path / "mine", PAIRS, seeds=1))
    assert tables.stress(findings).rows == ()
    with pytest.raises(MissingDataError, match="needlehoop stress"):
        stress_figure(findings)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "axis,severity\nnone,0\n",
        f"{HEAD}\nnone,0,,,100,1.5\n",
        f"{HEAD}\nnone,x,,,100,1.0\n",
        f"{HEAD}\nnone,0\n",
    ],
)
def test_a_damaged_table_is_left_out_and_named(study, text):
    (study / "rgb_default/human/seed0/stress.csv").write_text(text)
    findings = study_findings(study)
    assert [one.result.cameras for one in robustness(findings)] == ["dep_front+seg_side"]
    assert any("stress.csv" in str(one) for one in findings.left_out)
