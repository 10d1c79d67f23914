"""Tables: what is in them, and that no character breaks them."""

import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_files import PAIRS, REWARDED, cells_of, texts_of, write_answers, write_run, write_study

from needlehoop.study.data import paper
from needlehoop.study.data.answers import LESS
from needlehoop.study.data.paper import reward_label
from needlehoop.study.render.table import Column, Estimated, Of, Table
from needlehoop.study.report.tables import (
    agreements,
    all_tables,
    improvements,
    phases,
    results,
    rewards,
    table_1,
    table_2,
    write_tables,
)
from needlehoop.study.stats.findings import StudyFindings, paper_findings, study_findings
from needlehoop.study.stats.statistics import OVER_EPISODES, Interval

NOWHERE = Path("nowhere")
"""A folder of studies without a probe."""


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "main"
    return write_study(folder, [*PAIRS, *REWARDED], seeds=3)


@pytest.fixture(scope="module")
def findings(study) -> StudyFindings:
    write_answers(study)
    return study_findings(study)


def test_table_2_sets_ours_beside_the_papers(findings):
    rows = texts_of(table_2(findings))
    assert len(rows) == 16
    first = rows[0]
    assert (first["list"], first["cameras"]) == ("RGB and depth", "dep_front+rgb_side")
    assert (first["measured"], first["the paper's measured"]) == ("1", "1")
    assert (first["the paper's return"], first["the paper's VLM"]) == ("8.92", "1")
    ours = {r.cameras: r.value.value for r in findings.ranked}
    assert float(first["return"]) == pytest.approx(ours["dep_front+rgb_side"], abs=0.006)
    for name in ("RGB and depth", "RGB and segmentation", "Depth and segmentation"):
        own = [row for row in rows if row["list"] == name]
        assert [row["measured"] for row in own] == [str(i + 1) for i in range(len(own))]
        returns = [float(row["return"]) for row in own]
        assert returns == sorted(returns, reverse=True)


def test_agreement_is_given_for_each_pair_of_sides(findings):
    rows = texts_of(agreements(findings))
    # Of the paper's VLM, claude, claude asked in three other ways and the paper's measured, by
    # final return and over training, and of the models in the paper; the study's own VLM has the
    # paper's orders, and is the paper's.
    assert len(rows) == ((5 + 1) * 2 + 5) * (3 + 1)
    papers = [r for r in cells_of(agreements(findings)) if said_of(r) == PAPERS]
    ps = [row["p of tau-b"] for row in papers]
    papers = [r for r in rows if said_of(r) == PAPERS]
    *alone, together = papers
    assert [(r["tau-b"], r["best found"], r["worst found"]) for r in alone] == [
        ("0.60", "yes", "yes")
    ] * 3
    assert together["list"] == "all lists"
    assert (together["tau-b"], together["best found"]) == ("0.60", "3 of 3")
    # No list alone rules chance out; together they do.
    assert min(ps[:3]) > 0.1
    assert ps[3] == pytest.approx(0.007, abs=0.003)


PAPERS = ("the paper's VLM", "the paper's measured")


def said_of(row) -> tuple[str, str]:
    return row["prediction"], row["against"]


PROBE = (
    "place,cameras,score\n1,rgb_front+dep_side,0.8\n2 to 3,rgb_front+rgb_side,0.7\n"
    "2 to 3,dep_front+rgb_side,0.7\n4,rgb_default+dep_default,0.6\n"
    "5,rgb_default,0.5\n,constant,0.0\n"
)


def test_rankings_stand_side_by_side(tmp_path):
    study = write_study(tmp_path / "main", [("rgb_default", "human")], seeds=1)
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "ranking.csv").write_text(PROBE)
    table = table_2(study_findings(study))
    who = ("the paper's VLM", "claude", "probe", "measured", "return over training")
    who += ("the paper's measured",)
    asked = [f"claude, {how}" for how in LESS]
    numbers = ("return", "return, 95 %", "success, %", "the paper's return")
    assert table.header == ("list", "cameras", *numbers, *who[:2], *asked, *who[2:])
    rows = {(row["list"], row["cameras"]): row for row in texts_of(table)}
    assert len(rows) == 16
    best = rows["RGB and depth", "dep_front+rgb_side"]
    # Claude's first is the paper's second; the probe's tie shares its mean place.
    assert [best[name] for name in who] == ["1", "2", "2.5", "", "", "1"]
    assert rows["RGB and depth", "rgb_default"]["measured"] == "1 of 1"
    # The probe has not seen all of the other lists.
    assert rows["Depth and segmentation", "dep_front+seg_side"]["probe"] == ""
    said = {*map(said_of, texts_of(agreements(study_findings(study))))}
    assert {(one, "the paper's measured") for one in who[:3]} <= said
    assert "probe" not in table_2(paper_findings(NOWHERE)).header
    assert "probe" in table_2(paper_findings(tmp_path)).header


def test_a_study_with_an_order_of_its_own_has_a_column_of_its_own(tmp_path):
    study = write_study(tmp_path / "main", PAIRS, seeds=1)
    write_answers(study)
    path = study / "vlm" / "rankings.json"
    found = json.loads(path.read_text())
    for entry in found["lists"]:
        entry["rankings"][0].reverse()
    path.write_text(json.dumps(found))
    table = table_2(study_findings(study))
    asked = [f"claude, {how}" for how in LESS]
    assert table.header[6 : 9 + len(asked)] == ("the paper's VLM", "claude", *asked, "VLM")
    row = next(r for r in texts_of(table) if r["the paper's VLM"] == "1")
    assert row["VLM"] == "5"


def test_a_probe_that_can_not_be_read_is_named(tmp_path):
    study = write_study(tmp_path / "main", [("rgb_default", "human")], seeds=1)
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "ranking.csv").write_text("place,cameras\n1,x\n")
    found = study_findings(study)
    assert [str(one) for one in found.left_out] == [
        "../probe/ranking.csv: has no usable 0.score, rows"
    ]


def test_what_was_not_run_is_said(tmp_path):
    write_study(tmp_path, [("rgb_default", "human"), ("dep_default", "human")], seeds=1)
    found = study_findings(tmp_path)
    rows = texts_of(table_2(found))
    said = [row["return, 95 %"] for row in rows]
    assert said.count("not run") == 16 - 3
    assert {row["measured"] for row in rows if row["cameras"] == "rgb_default"} == {"1 of 1"}
    assert {*said} == {"not run", "one seed, no interval"}
    assert "4 of 5 not measured" in {row["regret"] for row in texts_of(agreements(found))}
    assert "improvement" not in {table.name for table in all_tables(found)}


def test_the_papers_own_tables(findings):
    rows = texts_of(table_2(paper_findings(NOWHERE)))
    assert [row["the paper's return"] for row in rows][:5] == [
        "8.92", "8.05", "3.40", "2.41", "1.56",
    ]  # fmt: skip
    assert "return" not in rows[0]
    # Its text says of which it was surprised: depth from the side, and segmentation.
    places = {row["cameras"]: (row["the paper's VLM"], row["the paper's measured"]) for row in rows}
    assert [name for name, (said, measured) in places.items() if measured < said] == [
        "rgb_front+dep_side",
        "rgb_default+seg_default",
        "seg_front+seg_side",
        "seg_default",
    ]
    said = {row["question"]: row for row in texts_of(table_1(findings))}
    assert said["Best view for subtask 2"] == {
        "question": "Best view for subtask 2",
        "test-model": "side",
        "claude": "side",
        "the paper's VLM": "side",
    }
    assert len(table_1(paper_findings(NOWHERE)).rows) == 9
    assert len(results(paper_findings(NOWHERE)).rows) == 15


def test_results_have_places_among_those_of_their_reward(findings):
    rows = texts_of(results(findings))
    assert len(rows) == len(findings.results)
    rewarded = [(row["reward"], int(row["place"])) for row in rows]
    images = ["VLM, text"] * 3 + ["VLM, text + image"] * 3
    assert [reward for reward, _ in rewarded] == ["human"] * 14 + images
    assert [place for _, place in rewarded] == [*range(1, 15), 1, 2, 3, 1, 2, 3]
    for reward in {reward for reward, _ in rewarded}:
        returns = [float(row["return"]) for row in rows if row["reward"] == reward]
        assert returns == sorted(returns, reverse=True)


def test_rewards_stand_together_with_the_papers(findings):
    rows = texts_of(rewards(findings))
    assert len(rows) == 9
    for result in (one for one in findings.results if one.reward == "vlm_img"):
        (row,) = (
            one
            for one in rows
            if (one["cameras"], one["reward"]) == (result.cameras, "VLM, text + image")
        )
        for column, values, error in (
            ("return", [final.value for final in result.finals], 0.006),
            ("success at best, %", [100 * (final.best or 0) for final in result.finals], 0.6),
            (
                "success over training, %",
                [100 * (one.success_area or 0) for one in result.finals],
                0.6,
            ),
        ):
            assert float(row[column]) == pytest.approx(np.mean(values), abs=error)
    assert [row["reward"] for row in rows[:3]] == ["human", "VLM, text", "VLM, text + image"]
    (cheat,) = [row for row in rows if row["the paper's return"] == "6.53"]
    assert (cheat["cameras"], cheat["reward"]) == ("rgb_front+seg_side", "VLM, text")
    assert cheat["cheat, %"] == "60"


def test_rewards_say_what_was_learnt_and_lost_again(tmp_path):
    cameras = "dep_front+seg_side"
    write_run(tmp_path, cameras)
    # Not called vlm_text while it is made: runs of that name never thread there.
    hacked = tmp_path / cameras / "vlm_text"
    (write_run(tmp_path / "other", cameras, noise=1).parent).rename(hacked)
    path = hacked / "seed0" / "evaluation.json"
    last = json.loads(path.read_text())
    path.write_text(json.dumps(last | {"success": 0.1, "cheat": 0.9}))
    write_run(tmp_path, cameras, "vlm_img", updates=50)
    with (hacked / "seed0" / "evaluations.csv").open(newline="") as file:
        ways = [float(row["success"]) for row in csv.DictReader(file)]
    said = {row["reward"]: row for row in texts_of(rewards(study_findings(tmp_path)))}
    row = said["VLM, text"]
    assert row["success, %"] == "10"
    assert row["success at best, %"] == f"{100 * max(ways):.0f}" != "10"
    assert said["VLM, text + image"]["success at best, %"] == ""


def test_rewards_say_how_soon_each_seed_threads(findings):
    rows = {(row["cameras"], row["reward"]): row for row in texts_of(rewards(findings))}
    for result in findings.results:
        if (row := rows.get((result.cameras, reward_label(result.reward)))) is None:
            continue
        for run, said in zip(result.runs, row["M steps to 90 %"].split(", "), strict=True):
            assert run.metrics is not None
            step, share = run.metrics["step"], run.metrics["success"]
            sooner = [
                step[i] for i in range(4, len(step)) if np.nanmean(share[i - 4 : i + 1]) >= 0.9
            ]
            assert said == (f"{sooner[0] / 1e6:.2f}" if sooner else "not reached")
    told = {said for row in rows.values() for said in row["M steps to 90 %"].split(", ")}
    assert "not reached" in told
    assert len(told) > 2


def test_chances_to_be_better_add_up(findings):
    table = improvements(findings)
    assert len(table.rows) == 14
    for i in range(14):
        for j in range(14):
            cell, other = table.rows[i][j + 1], table.rows[j][i + 1]
            if i == j:
                assert cell is None
            else:
                assert isinstance(cell, Estimated)
                assert isinstance(other, Estimated)
                assert cell.value + other.value == pytest.approx(1.0)


cells = st.text(" ,;\"'\n|\\aä", max_size=5)


@given(st.lists(st.tuples(cells, cells), max_size=3))
def test_csv_brings_every_cell_back(rows):
    table = Table("t", "T", (Column("a"), Column("b")), tuple(rows))
    assert list(csv.reader(io.StringIO(table.csv(), newline=""))) == [["a", "b"], *map(list, rows)]


def test_markdown_and_latex_escape_what_they_must():
    nasty = "50 % of a_b & c|d {e} $f^2$ #1 ~ \\x <script> [l](u) `c`\nnext"
    table = Table("my_table", "A & B", (Column("100 %"),), ((nasty,),), "note_1")
    latex = table.latex()
    row = latex.splitlines()[7]
    assert row == (
        r"50 \% of a\_b \& c|d \{e\} \$f\textasciicircum{}2\$ \#1 \textasciitilde{}"
        r" \textbackslash{}x \textless{}script\textgreater{} [l](u) `c` next \\"
    )
    assert r"\caption{A \& B. note\_1}" in latex
    assert r"\label{tab:my-table}" in latex
    line = table.markdown().splitlines()[4]
    assert line.count("|") - line.count(r"\|") == 2
    assert r"\<script\>" in line
    assert r"\[l\](u)" in line


def test_tables_are_written_three_ways(findings, tmp_path):
    written = write_tables(findings, tmp_path)
    names = {"results", "table_1", "table_2", "agreement", "rewards", "improvement"}
    names |= {"phases"}
    assert {path.name for path in written} == {
        f"{name}.{kind}" for name in names for kind in ("csv", "md", "tex")
    }
    with (tmp_path / "table_2.csv").open(newline="") as file:
        assert len(list(csv.reader(file))) == 17


def test_tables_without_rows_any_more_are_removed(tmp_path):
    folder = tmp_path / "tables"
    study = write_study(tmp_path / "main", [("rgb_default", "human"), ("rgb_default", "vlm_text")])
    before = write_tables(study_findings(study), folder)
    (folder / "own.csv").write_text("mine\n")
    shutil.rmtree(study / "rgb_default" / "vlm_text")
    after = write_tables(study_findings(study), folder)
    assert {path.name for path in before} - {path.name for path in after} == {
        f"rewards.{kind}" for kind in ("csv", "md", "tex")
    }
    assert {*folder.iterdir()} == {*after, folder / "own.csv"}


def test_the_papers_lists_hold_its_14_camera_sets():
    lists = paper.lists()
    assert {name: len(members) for name, members in lists.items()} == {
        "rgb_dep": 5,
        "rgb_seg": 5,
        "dep_seg": 6,
    }
    assert {name for members in lists.values() for name in members} == set(paper.measured())


def test_predictions_of_an_imitated_study_are_held_against_its_own_runs(tmp_path):
    sets = ["rgb_default", "rgb_default+dep_default", "rgb_front+rgb_side", "rgb_front+dep_side"]
    pairs = [(cameras, "expert") for cameras in (*sets, "dep_front+rgb_side")]
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "ranking.csv").write_text(PROBE)
    own = study_findings(write_study(tmp_path / "main", pairs, seeds=2))
    assert own.main_reward == "expert"
    assert ("probe", "measured") in {said_of(r) for r in texts_of(agreements(own)) if r["tau-b"]}


def test_numbers_become_text_by_their_column():
    points, share = Column("return", form="+.2f"), Column.share("success")
    whole = Interval(0.1, 0.25, OVER_EPISODES)
    for column, cell, text in (
        (points, None, ""),
        (points, 1.005, "+1.00"),
        (points, float("nan"), "undefined"),
        (points, "not run", "not run"),
        (points, Estimated(1.0, Interval(-1.0, 3.0)), "+1.00 (-1.00 to +3.00)"),
        (points, Estimated(1.0), "+1.00"),
        (share, whole, "10 to 25 (over episodes)"),
        (share, [0.5, "never", None, [1.0, 0.0]], "50, never, , 100, 0"),
        (Column("place"), Of(1.5, 4), "1.5 of 4"),
        (Column("place"), 3, "3"),
        (Column("hit"), True, "yes"),
        (Column("p", form="p"), 0.00041, "0.0004"),
        (Column("p", form="p"), 0.041, "0.04"),
        (Column("steps", "M", ".2f", 1e-6), 512_000, "0.51"),
    ):
        assert column.text(cell) == text
    assert (share.heading, points.heading) == ("success, %", "return")


def rewrite(run, **numbers):
    path = run / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | numbers))


def test_the_phase_that_loses_most_episodes_is_named(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default")
    for grasped, lifted, threaded, said in (
        (1.0, 1.0, 0.97, ""),
        (0.2, 0.2, 0.1, "reach"),
        (0.9, 0.1, 0.1, "lift"),
        (0.9, 0.8, 0.0, "insert"),
    ):
        rewrite(run, grasped=grasped, lifted=lifted, threaded=threaded)
        (row,) = cells_of(phases(study_findings(tmp_path / "main")))
        assert (row["fails in"], row["threaded, %"]) == (said, threaded)
    rewrite(run, grasped=2.0)
    left_out = study_findings(tmp_path / "main").left_out
    assert any("no usable grasped" in one.reason for one in left_out)


def test_an_episode_that_goes_past_a_fact_has_not_failed_there(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default")
    for grasped, lifted, threaded, said in (
        (1.0, 0.5, 1.0, ""),
        (0.9, 0.1, 0.6, "lift and insert"),
        (0.9, 0.1, 0.05, "lift"),
        (0.9, 0.1, 0.11, "lift"),
    ):
        rewrite(run, grasped=grasped, lifted=lifted, threaded=threaded)
        (row,) = cells_of(phases(study_findings(tmp_path / "main")))
        assert (row["fails in"], row["lifted, %"]) == (said, lifted)


CUBE = {"name": "cube", "goal": "on spot", "columns": ["success", "held", "on spot"]}
CUBE |= {"phases": [["pick up", "held"], ["put down", "on spot"]], "cheat": False}


def tell(run: Path, task: object) -> None:
    path = run / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"task": task}))


def test_a_task_without_cheats_has_names_of_its_own(tmp_path):
    study = tmp_path / "main"
    run = write_run(study, "dep_default")
    tell(run, CUBE)
    last = {"episodes": 10, "return": 1.0, "success": 0.4, "held": 0.9, "on spot": 0.4}
    (run / "evaluation.json").write_text(json.dumps(last))
    (run / "evaluations.csv").unlink()
    found = study_findings(study)
    assert found.left_out == ()
    assert found.goal == "on spot"
    assert texts_of(results(found))[0]["cheat, %"] == ""
    (row,) = texts_of(phases(found))
    assert row == {
        "cameras": "dep_default",
        "held, %": "90",
        "on spot, %": "40",
        "fails in": "put down",
        "reward": "human",
        "seeds": "1",
    }
    # Beside another task each has its own columns; seeds of two tasks have no mean.
    write_run(study, "rgb_default")
    rows = {row["cameras"]: row for row in texts_of(phases(study_findings(study)))}
    assert (rows["rgb_default"]["held, %"], rows["dep_default"]["threaded, %"]) == ("", "")
    assert rows["rgb_default"]["threaded, %"] != ""
    assert study_findings(study).goal == "success"
    write_run(study, "dep_default", seed=1)
    assert [row["cameras"] for row in texts_of(phases(study_findings(study)))] == ["rgb_default"]
