"""What predictions cost, and what choosing by them loses."""

import numpy as np
import pytest
from study_files import PAIRS, write_run, write_study

from analysis.predictions import ONE_SEED, cost_and_regret, held
from analysis.seeds import by_seed
from needlehoop.study.stats.findings import study_findings
from needlehoop.study.stats.predictions import FAST, IMITATION, PAPERS_MEASURED, PROBE
from needlehoop.study.stats.run import RETURN, TRAINING


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
    rows = [
        f"{name},1" for name in ("rgb_default", "rgb_default+dep_default", "rgb_front+rgb_side")
    ]
    rows += [f"{name},2" for name in ("rgb_front+dep_side", "dep_front+rgb_side")]
    (root / "probe" / "ranking.csv").write_text("\n".join(["cameras,score", *rows]) + "\n")
    (root / "probe" / "manifest.json").write_text('{"wall_time": 600.0, "cpus": 4}')
    (root / "probe" / "config.yaml").write_text("engine: {threads: 0}\n")
    return root


def test_predictions_have_a_cost_and_a_regret(studies):
    findings = study_findings(studies / "main")
    here, soon, there = held(findings)
    cost = {one.who: one.core_minutes for one in here.fits}
    # Two runs of 97 buffers of 16 s for each of 14 sets, on a core; imitation's say no cores.
    assert cost[FAST] == pytest.approx(14 * 2 * 97 * 16 / 60)
    assert cost[PROBE] == 40.0
    assert cost[IMITATION] is None
    assert cost["the paper's VLM"] == 0.0
    values = findings.measured
    assert all(
        regret >= 0
        for own in (here, soon, there)
        for one in own.fits
        for regret in one.regrets.values()
    )
    first = next(one for one in here.fits if one.who == PROBE)
    (members,) = first.regrets
    tied = (values["rgb_front+dep_side"] + values["dep_front+rgb_side"]) / 2
    assert first.regret == pytest.approx(max(values[name] for name in members) - tied)
    # Of one list alone nothing is said over all.
    assert first.tau is None
    assert PROBE not in {one.who for one in here.whole}
    drawn = {text.get_text() for text in cost_and_regret(findings).axes[0].texts}
    assert FAST in drawn
    assert PROBE not in drawn
    assert {one.who for one in here.fits} - {one.who for one in there.fits} == {PAPERS_MEASURED}


def test_a_study_with_several_seeds_is_foretold_by_one_of_them(studies, tmp_path):
    alone, *_ = held(study_findings(studies / "main"))
    assert ONE_SEED not in {one.who for one in alone.fits}
    findings = study_findings(studies / "fast")
    here, soon, there = held(findings)
    assert ONE_SEED not in {one.who for one in there.fits}
    for side, measure in ((here, RETURN), (soon, TRAINING)):
        (own,) = [one for one in side.fits if one.who == ONE_SEED]
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
    assert {one.over_seeds for one in here.fits} == {None}


def test_three_seeds_give_regrets_an_interval(tmp_path):
    write_study(tmp_path / "main", PAIRS, seeds=3)
    findings = study_findings(tmp_path / "main")
    here, _, there = held(findings)
    foretold = [one for one in here.fits if one.who != ONE_SEED]
    assert foretold
    for one in foretold:
        assert one.over_seeds is not None
        assert 0.0 <= one.over_seeds.regret.low <= one.over_seeds.regret.high
    assert any(one.over_seeds and one.over_seeds.regret.high > 0.0 for one in foretold)
    assert {one.over_seeds for one in there.fits} == {None}
    drawn = [one for one in here.whole if one.who != ONE_SEED and one.core_minutes is not None]
    axes, _, _ = cost_and_regret(findings).axes
    # Each has its lists, its interval, its mean and its name's line; what one seed took is not on
    # record here, so it has no place.
    assert len(axes.lines) == 1 + 4 * len(drawn)


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
        "Regret by our final returns",
        "Regret by our returns over training",
        "Regret by the paper's returns",
    ]
    said = {text.get_text() for text in figure.axes[0].texts}
    assert {"fast protocol", "paper's VLM", "chosen blindly"} <= said
    assert "imitation" not in said
    write_run(tmp_path / "main", "rgb_default")
    assert len(cost_and_regret(study_findings(tmp_path / "main")).axes) == 1
    findings = study_findings(studies / "main")
    object.__setattr__(findings, "predictions", ())
    object.__setattr__(findings, "results", ())
    with pytest.raises(ValueError, match="predicted"):
        cost_and_regret(findings)
