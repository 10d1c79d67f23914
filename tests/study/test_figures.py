"""Figures: that they are drawn, from what is there, the same every time."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from study_files import BUFFER, PAIRS, REWARDED, UPDATES, change, write_run, write_study

from needlehoop.cli.main import main
from needlehoop.study.render.figures import (
    draw,
    learning_curves,
    reward_comparison,
)
from needlehoop.study.render.style import WIDTH, new_figure, save, styled
from needlehoop.study.stats.findings import study_findings

DRAWN = {"learning_curves.png", "rewards.png", "final_values.png"}


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "main"
    pairs = [(name, "human") for name in ("dep_front+seg_side", "rgb_default", "segdep_front")]
    return write_study(folder, [*pairs, *REWARDED[:2]], seeds=3)


def test_plot_draws_all_and_repeats_to_the_byte(study, tmp_path, capsys):
    assert main(["plot", str(study), "--out", str(tmp_path)]) == 0
    output = capsys.readouterr().out
    figures, tables = tmp_path / "figures", tmp_path / "tables"
    assert {path.name for path in figures.iterdir()} == DRAWN
    assert all(str(path) in output for path in [*figures.iterdir(), *tables.iterdir()])
    first = {path: path.read_bytes() for path in figures.iterdir()}
    for path in first:
        with Image.open(path) as image:
            # 85 mm at 300 dpi, and not blank.
            assert image.width == pytest.approx(WIDTH * 300, abs=1)
            assert np.asarray(image.convert("L")).std() > 10
    draw(study_findings(study), figures)
    assert {path: path.read_bytes() for path in figures.iterdir()} == first


def test_what_cannot_be_drawn_any_more_goes(tmp_path):
    (tmp_path / "rewards.png").write_text("old")
    (write_run(tmp_path / "main", "rgb_default") / "metrics.csv").unlink()
    (drawn,) = draw(study_findings(tmp_path / "main"), tmp_path)
    assert [*tmp_path.glob("*.png")] == [drawn.file]
    assert drawn.name == "final_values"


def test_many_curves_are_grouped_as_in_the_paper(tmp_path):
    for cameras, _ in (*PAIRS, ("segdep_front", "human")):
        write_run(tmp_path, cameras, updates=20)
    with styled():
        panels = learning_curves(study_findings(tmp_path)).axes
    assert [(axes.get_title("left"), len(axes.get_legend().get_texts())) for axes in panels] == [
        ("RGB and depth", 5),
        ("RGB and segmentation", 5),
        ("Depth and segmentation", 6),
        ("Others", 1),
    ]


def test_a_curve_ends_at_the_mean_of_its_last_buffers_with_students_interval(study):
    findings = study_findings(study)
    place, result = next(
        (i, result) for i, result in enumerate(findings.ranked) if result.cameras == "rgb_default"
    )
    with styled():
        (axes,) = learning_curves(findings).axes
    x, y = axes.lines[place].get_data()
    assert x[-1] == pytest.approx(UPDATES * BUFFER / 1e6)
    last = round(0.04 * UPDATES)
    ends = [run.metrics["return"][-last:].mean() for run in result.runs if run.metrics is not None]
    assert y[-1] == pytest.approx(np.mean(ends))
    # 4.303: the 97.5 % point of t with two degrees of freedom.
    high = axes.collections[place].get_paths()[0].vertices[:, 1]
    assert np.isclose(high, y[-1] + 4.303 * np.std(ends, ddof=1) / np.sqrt(3), atol=1e-3).any()


def test_rewards_are_compared_in_training_and_in_evaluations(study):
    for run in (study / "dep_front+seg_side" / "vlm_img").iterdir():
        change(run / "evaluation.json", success=0.1)
    with styled():
        figure = reward_comparison(study_findings(study))
    returns, trained, evaluated = figure.axes
    assert returns.get_title("left") == "dep_front+seg_side"
    (legend,) = figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert named == ["human", "VLM, text", "VLM, text + image"]
    # A line and its name have one colour, and those who only touch thread least.
    drawn = [line.get_color() for line in legend.get_lines()]
    assert all([line.get_color() for line in axes.lines] == drawn for axes in figure.axes)
    ends = [line.get_ydata()[-1] for line in trained.lines]
    assert ends[1] == min(ends) == pytest.approx(0.2)
    assert ends[2] > 0.5
    # What the mean action does is not what training's sampled actions do.
    mean = evaluated.lines[2].get_ydata()
    assert mean[-1] == pytest.approx(0.1)
    assert np.isnan(mean[0])


def test_names_that_differ_behind_their_last_dot_are_two_files(tmp_path):
    figure, _ = new_figure(20)
    names = [f"algo.learning_rate-{rate}" for rate in ("0.0003", "0.0005")]
    assert [save(figure, tmp_path / name).name for name in names] == [f"{n}.png" for n in names]
