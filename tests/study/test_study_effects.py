"""Where sets of cameras fail, what helps, and what predictions cost."""

import json

import numpy as np
import pytest
from study_files import PAIRS, write_run, write_study

from needlehoop.study.data import paper
from needlehoop.study.data.findings import paper_findings, study_findings
from needlehoop.study.data.predictions import FAST, IMITATION, PROBE
from needlehoop.study.render.curves import MissingDataError
from needlehoop.study.report.phases import phases, reached
from needlehoop.study.stats.costs import cost_and_regret, costs, markets
from needlehoop.study.stats.effects import effects
from needlehoop.study.stats.measures import RETURN, TRAINING, by_seed
from needlehoop.study.stats.reliability import ONE_SEED


def rewrite(run, **numbers):
    path = run / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | numbers))


def column(table, name):
    return [row[table.header.index(name)] for row in table.rows]


@pytest.mark.parametrize(
    ("grasped", "lifted", "success", "said"),
    [
        (1.0, 1.0, 0.97, ""),
        (0.2, 0.2, 0.1, "grasp"),
        (0.9, 0.1, 0.1, "lift"),
        (0.9, 0.8, 0.0, "insert"),
    ],
)
def test_the_phase_that_loses_most_episodes_is_named(tmp_path, grasped, lifted, success, said):
    run = write_run(tmp_path / "main", "rgb_default")
    rewrite(run, grasped=grasped, lifted=lifted, success=success)
    table = phases(study_findings(tmp_path / "main"))
    assert column(table, "fails in") == [said]
    assert column(table, "threaded, %") == [f"{100 * success:.0f}"]


def test_a_needle_that_goes_past_the_lift_position_has_not_failed_there(tmp_path):
    study = tmp_path / "main"
    direct = write_run(study, "dep_default", "vlm_text")
    short = write_run(study, "rgb_default", "vlm_text")
    human = write_run(study, "rgb_default", "human")
    rewrite(direct, grasped=1.0, lifted=0.5, success=1.0)
    rewrite(short, grasped=0.9, lifted=0.1, success=0.05)
    rewrite(human, grasped=0.9, lifted=0.1, success=0.05)
    found = reached(study_findings(study))
    assert found["rgb_default", "vlm_text"].fails_in == "carry and insert"
    assert found["rgb_default", "human"].fails_in == "lift"


def test_runs_that_do_not_say_how_far_they_came_have_no_phase(tmp_path):
    run = write_run(tmp_path / "main", "rgb_default")
    assert phases(study_findings(tmp_path / "main")).rows == ()
    rewrite(run, grasped=2.0, lifted=0.0)
    left_out = study_findings(tmp_path / "main").left_out
    assert any("no usable grasped" in one.reason for one in left_out)


def test_effects_come_back_from_returns_that_were_made_of_them(tmp_path):
    study = tmp_path / "main"
    worth = {"two": 0.5, "pair": 1.0, "dep": 2.0, "seg": -0.25}
    made = {}
    for cameras in paper.measured():
        cams = cameras.split("+")
        value = 3.0 + worth["two"] * (len(cams) == 2)
        value += worth["pair"] * any("front" in cam for cam in cams)
        value += worth["dep"] * any(cam.startswith("dep") for cam in cams)
        value += worth["seg"] * any(cam.startswith("seg") for cam in cams)
        made[cameras] = value
        rewrite(write_run(study, cameras), **{"return": value})
    table = effects(study_findings(study))
    told = [float(cell.split()[0]) for cell in column(table, "return (95 %)")]
    np.testing.assert_allclose(told, list(worth.values()), atol=0.006)


def test_sets_too_few_or_alike_say_nothing_of_effects(tmp_path):
    study = tmp_path / "main"
    for cameras in ("rgb_default", "dep_default"):
        write_run(study, cameras)
    assert effects(study_findings(study)).rows == ()
    # Nobody here has two cameras, or front and side.
    for cameras in ("seg_default", "segdep_default", "segdep_front"):
        write_run(study, cameras)
    assert column(effects(study_findings(study)), "trait") == [
        "depth in a camera",
        "segmentation in a camera",
    ]


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    """A study of all sets; beside it the fast protocol's, imitation's, and a probe's ranking."""
    root = tmp_path_factory.mktemp("results")
    write_study(root / "main", PAIRS, seeds=1)
    write_study(root / "fast", [(name, "vlm_text") for name, _ in PAIRS], seeds=2)
    write_study(root / "imitation", [(name, "expert") for name, _ in PAIRS], seeds=1)
    for run in root.glob("fast/*/*/*"):
        config = run / "config.yaml"
        config.write_text(config.read_text() + "engine: {threads: 1}\n")
    (root / "probe").mkdir()
    rows = [f"{name},1" for name in ("RGB (D)", "RGB (D) + DEP (D)", "RGB (F) + RGB (S)")]
    rows += [f"{name},2" for name in ("RGB (F) + DEP (S)", "DEP (F) + RGB (S)")]
    (root / "probe" / "ranking.csv").write_text("\n".join(["cameras,score", *rows]) + "\n")
    (root / "probe" / "manifest.json").write_text('{"wall_time": 600.0, "cpus": 4}')
    (root / "probe" / "config.yaml").write_text("engine: {threads: 0}\n")
    return root


def test_predictions_have_a_cost_and_a_regret(studies):
    findings = study_findings(studies / "main")
    here, soon, there = markets(findings)
    cost = {one.who: one.core_minutes for one in here.bargains}
    # Two runs of 97 buffers of 16 s for each of 14 sets, on a core; imitation's say no cores.
    assert cost[FAST] == pytest.approx(14 * 2 * 97 * 16 / 60)
    assert cost[PROBE] == 40.0
    assert cost[IMITATION] is None
    assert cost["the paper's VLM"] == 0.0
    # Theirs was told by the paper's own numbers, from which the made-up returns come.
    values = {result.cameras: result.value.value for result in findings.ranked}
    for one in (*here.bargains, *soon.bargains, *there.bargains):
        assert set(one.regrets) <= set(here.blind)
        assert all(regret >= 0.0 for regret in one.regrets.values())
    first = next(one for one in here.bargains if one.who == PROBE)
    (members,) = first.regrets
    tied = (values["rgb_front+dep_side"] + values["dep_front+rgb_side"]) / 2
    assert first.regret == pytest.approx(max(values[name] for name in members) - tied)
    table = costs(findings)
    assert column(table, "against").count("measured") == len(here.bargains)
    assert "not on record" in column(table, "core-minutes")


def test_a_study_with_several_seeds_is_foretold_by_one_of_them(studies, tmp_path):
    alone, *_ = markets(study_findings(studies / "main"))
    assert ONE_SEED not in {one.who for one in alone.bargains}
    findings = study_findings(studies / "fast")
    here, soon, there = markets(findings)
    assert ONE_SEED not in {one.who for one in there.bargains}
    for market, measure in ((here, RETURN), (soon, TRAINING)):
        (own,) = [one for one in market.bargains if one.who == ONE_SEED]
        # One of two runs of 97 buffers of 16 s for each of 14 sets, on a core.
        assert own.core_minutes == pytest.approx(14 * 97 * 16 / 60)
        ends = by_seed(findings, measure)
        for members, regret in own.regrets.items():
            lost = []
            for seed in (0, 1):
                chosen = max(members, key=lambda name, of=seed: ends[name][of])
                others = {name: ends[name][1 - seed] for name in members}
                lost.append(max(others.values()) - others[chosen])
            assert regret == pytest.approx(sum(lost) / 2)
        assert len(own.regrets) == 3
    # Two seeds are too few for an interval.
    assert [one.interval for one in here.bargains] == [None] * len(here.bargains)


def test_three_seeds_give_regrets_an_interval(tmp_path):
    write_study(tmp_path / "main", PAIRS, seeds=3)
    findings = study_findings(tmp_path / "main")
    here, _, there = markets(findings)
    foretold = [one for one in here.bargains if one.who != ONE_SEED]
    assert foretold
    for one in foretold:
        assert one.interval is not None
        low, high = one.interval
        assert 0.0 <= low <= high
    assert any(low < high for one in foretold for low, high in [one.interval or (0.0, 0.0)])
    assert {one.interval for one in there.bargains} == {None}
    rows = [row for row in costs(findings).rows if row[1] == "measured"]
    assert [bool(row[3]) for row in rows] == [row[0] != ONE_SEED for row in rows]
    axes, _, _ = cost_and_regret(findings).axes
    # Each has its lists, its interval, its mean and its name's line; what one seed took is not on
    # record here, so that it has no place.
    assert len(axes.lines) == 1 + 4 * len(foretold)


def test_names_in_the_figure_hide_neither_each_other_nor_points(studies):
    figure = cost_and_regret(study_findings(studies / "main"))
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts]
        assert len(boxes) > 3
        for i, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:i])
        points = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
        for x, y in axes.transData.transform(np.concatenate(points)):
            assert not any(box.contains(x, y) for box in boxes)


def test_what_was_measured_there_foretells_nothing(studies):
    findings = study_findings(studies / "fast")
    assert FAST not in {one.who for one in findings.predictions}
    assert IMITATION in {one.who for one in findings.predictions}


def test_cost_and_regret_are_drawn_for_each_measurement(studies, tmp_path):
    figure = cost_and_regret(study_findings(studies / "main"))
    assert [axes.get_title() for axes in figure.axes] == [
        "of final returns here",
        "of returns over training here",
        "of the paper's returns",
    ]
    said = {text.get_text() for text in figure.axes[0].texts}
    assert {"probe", "fast protocol", "paper's VLM", "chosen blindly"} <= said
    assert "imitation" not in said
    write_run(tmp_path / "main", "rgb_default")
    assert len(cost_and_regret(study_findings(tmp_path / "main")).axes) == 1
    assert len(cost_and_regret(paper_findings(tmp_path)).axes) == 1


def test_without_a_prediction_there_is_no_figure(studies, monkeypatch):
    findings = study_findings(studies / "main")
    object.__setattr__(findings, "predictions", ())
    with pytest.raises(MissingDataError, match="foretold"):
        cost_and_regret(findings)
