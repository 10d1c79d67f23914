"""Figures: that they are drawn, from what is there, the same every time."""

import csv
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from strength import ALL
from study_files import BUFFER, PAIRS, REWARDED, UPDATES, write_run, write_study

from needlehoop.cli.main import main
from needlehoop.study.data.records import read_study
from needlehoop.study.render.curves import (
    MissingDataError,
    learning_curves,
    reward_comparison,
)
from needlehoop.study.render.figures import draw, final_values, success_and_cheats
from needlehoop.study.render.style import WIDTH, styled
from needlehoop.study.stats.findings import paper_findings, study_findings
from needlehoop.study.stats.run import steps_to_share

DRAWN = {
    *("learning_curves", "rewards", "final_values", "success_and_cheats"),
}


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "main"
    pairs = [(name, "human") for name in ("dep_front+seg_side", "rgb_default", "segdep_front")]
    return write_study(folder, [*pairs, *REWARDED[:2]], seeds=2)


def sums(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def names(axes) -> list[str]:
    """What is written beside a panel's lines."""
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_plot_draws_all_and_repeats_to_the_byte(study, tmp_path, capsys):
    assert main(["plot", str(study), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    figures, tables = tmp_path / "figures", tmp_path / "tables"
    wanted = {f"{name}.{kind}" for name in DRAWN for kind in ("png", "svg")}
    assert {path.name for path in figures.iterdir()} == wanted
    assert all(str(path) in said for path in [*figures.iterdir(), *tables.iterdir()])
    for name in DRAWN:
        with Image.open(figures / f"{name}.png") as image:
            # 85 mm at 300 dpi, and not blank.
            assert image.width == pytest.approx(WIDTH * 300, abs=1)
            assert np.asarray(image.convert("L")).std() > 10
    if ALL:
        before = sums(figures)
        assert main(["plot", str(study), "--out", str(tmp_path)]) == 0
        assert sums(figures) == before


def test_nothing_to_draw_is_said_and_old_figures_go(tmp_path):
    (tmp_path / "rewards.png").write_text("old")
    drawn = {figure.name: figure for figure in draw(paper_findings(Path("nowhere")), tmp_path)}
    kept = {f"final_values.{kind}" for kind in ("png", "svg")}
    assert {path.name for path in tmp_path.iterdir()} == kept
    assert drawn["learning_curves"].missing == "no learning curves"
    assert drawn["final_values"].missing is None


def test_few_curves_share_a_panel(study):
    with styled():
        (axes,) = learning_curves(study_findings(study)).axes
    assert set(names(axes)) == {"rgb_default", "dep_front+seg_side", "segdep_front"}
    colours = [line.get_color() for line in axes.lines if len(line.get_xdata()) > 2]
    assert len(set(colours)) == 3


def test_many_curves_are_grouped_as_in_the_paper(tmp_path):
    for cameras, _ in (*PAIRS, ("segdep_front", "human")):
        write_run(tmp_path, cameras, updates=20)
    with styled():
        panels = learning_curves(study_findings(tmp_path)).axes
    assert [axes.get_title("left") for axes in panels] == [
        "RGB and depth",
        "RGB and segmentation",
        "Depth and segmentation",
        "Others",
    ]
    assert [len(names(axes)) for axes in panels] == [5, 5, 6, 1]
    assert all("rgb_default" in names(axes) for axes in panels[:2])
    # It keeps its colour from panel to panel, and no other in either has it.
    for axes in panels:
        colours = [line.get_color() for line in axes.lines if len(line.get_xdata()) > 2]
        assert len(set(colours)) == len(colours)
    first, second = (
        dict(
            zip(
                names(axes),
                [line.get_color() for line in axes.get_legend().get_lines()],
                strict=True,
            )
        )
        for axes in panels[:2]
    )
    assert first["rgb_default"] == second["rgb_default"]


def test_curves_of_another_task_are_in_no_list_of_the_papers(tmp_path):
    for cameras, _ in PAIRS[:8]:
        path = write_run(tmp_path, cameras, updates=20) / "manifest.json"
        manifest = json.loads(path.read_text())
        path.write_text(json.dumps(manifest | {"task": {**manifest["task"], "name": "reach"}}))
    panels = learning_curves(study_findings(tmp_path)).axes
    assert [(axes.get_title("left"), len(names(axes))) for axes in panels] == [("", 7), ("", 1)]


def test_a_curve_ends_at_the_mean_of_its_last_buffers(study):
    findings = study_findings(study)
    (result,) = [r for r in findings.ranked if r.cameras == "rgb_default"]
    with styled():
        axes = learning_curves(findings).axes[0]
    line = axes.lines[[r.cameras for r in findings.ranked].index("rgb_default")]
    x, y = line.get_xdata(), line.get_ydata()
    assert x[-1] == pytest.approx(UPDATES * BUFFER / 1e6)
    last = 0.04 * UPDATES
    ends = [
        run.metrics["return"][run.metrics["update"] > UPDATES - last].mean()
        for run in result.runs
        if run.metrics is not None
    ]
    assert y[-1] == pytest.approx(np.mean(ends))


def test_a_curve_breaks_where_a_run_ends_before_the_others(tmp_path):
    write_run(tmp_path, "rgb_default", seed=0, goal=2.0, updates=UPDATES // 2)
    write_run(tmp_path, "rgb_default", seed=1, goal=8.0)
    with styled():
        (axes,) = learning_curves(study_findings(tmp_path)).axes
    one, both = axes.lines[:2]
    assert one.get_linewidth() < both.get_linewidth()
    drawn = [~np.isnan(line.get_ydata()) for line in (both, one)]
    half = UPDATES // 2 * BUFFER / 1e6
    assert (both.get_xdata()[drawn[0]] <= half).all()
    assert (one.get_xdata()[drawn[1]] > half).all()
    # No line leads from one mean to the other.
    assert not (drawn[0] & drawn[1]).any()


def test_rewards_are_compared_where_there_are_several(study, tmp_path):
    with styled():
        figure = reward_comparison(study_findings(study))
    returns, threaded, evaluated = figure.axes
    assert returns.get_title("left") == "dep_front+seg_side"
    (legend,) = figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert named == ["human", "VLM, text", "VLM, text + image"]
    # A line and its name have one colour, and those who only touch thread least.
    drawn = [line.get_color() for line in legend.get_lines()]
    ends = {line.get_color(): line.get_ydata()[-1] for line in threaded.lines}
    assert [line.get_color() for line in returns.lines] == drawn == [*ends]
    assert min(ends, key=lambda colour: ends[colour]) == drawn[1]
    assert ends[drawn[1]] == pytest.approx(0.2)
    assert [line.get_color() for line in evaluated.lines] == drawn
    write_run(tmp_path, "rgb_default")
    with pytest.raises(MissingDataError, match="two rewards"):
        reward_comparison(study_findings(tmp_path))


def test_evaluations_show_what_training_does_not(tmp_path):
    cameras = "dep_front+seg_side"
    write_run(tmp_path, cameras)
    hacked = write_run(tmp_path, cameras, "vlm_img", noise=1)
    untried = write_run(tmp_path, cameras, "vlm_img_claude", noise=2)
    last = json.loads((hacked / "evaluation.json").read_text())
    (hacked / "evaluation.json").write_text(json.dumps(last | {"success": 0.1}))
    for name in ("evaluation.json", "evaluations.csv"):
        (untried / name).unlink()
    with styled():
        figure = reward_comparison(study_findings(tmp_path))
    _, threaded, evaluated = figure.axes
    sampled, mean = (axes.lines[1].get_ydata() for axes in (threaded, evaluated))
    assert sampled[-1] > 0.5
    assert mean[-1] == pytest.approx(0.1)
    assert np.isnan(mean[0])
    # Straight from evaluation to evaluation, whose steps are not the figure's.
    with (hacked / "evaluations.csv").open(newline="") as file:
        told = [(float(row["step"]) / 1e6, float(row["success"])) for row in csv.DictReader(file)]
    at = evaluated.lines[1].get_xdata()
    assert np.interp([x for x, _ in told[2:6]], at, mean) == pytest.approx(
        [y for _, y in told[2:6]], abs=0.05
    )


@pytest.mark.parametrize(
    ("before", "on_the_way", "lines"),
    [
        # Gone on with after its last evaluation, which then stands among those on the way.
        (256_000, True, 2),
        # Evaluated once, between two points of the figure: no line, and no error.
        (300_000, False, 1),
    ],
)
def test_evaluations_are_shown_by_their_steps(before, on_the_way, lines, tmp_path):
    write_run(tmp_path, "dep_front+seg_side")
    other = write_run(tmp_path, "dep_front+seg_side", "vlm_img", noise=1)
    manifest = json.loads((other / "manifest.json").read_text())
    (other / "manifest.json").write_text(json.dumps(manifest | {"finished": False}))
    early = json.loads((other / "evaluation.json").read_text()) | {"steps_trained": before}
    (other / "evaluation.json").write_text(json.dumps(early | {"success": 0.5}))
    if not on_the_way:
        (other / "evaluations.csv").unlink()
    with styled():
        evaluated = reward_comparison(study_findings(tmp_path)).axes[2]
    assert len(evaluated.lines) == lines
    for line in evaluated.lines[1:]:
        at, share = line.get_data()
        assert np.interp(before / 1e6, at, share) == pytest.approx(0.5, abs=0.05)
        assert share[~np.isnan(share)][-1] > 0.5


def test_cheats_stand_beside_successes(study):
    with styled():
        success, cheats = success_and_cheats(study_findings(study)).axes
    rows = [label.get_text() for label in success.get_yticklabels()]
    text_only = rows.index("dep_front+seg_side: VLM, text")
    assert success.patches[text_only].get_width() == pytest.approx(0.2, abs=0.01)
    assert cheats.patches[text_only].get_width() == pytest.approx(0.6, abs=0.01)
    assert [axes.get_title("left") for axes in (success, cheats)] == ["threaded", "cheated"]


def test_time_to_threshold_is_the_first_buffer_that_holds_it(tmp_path):
    run = write_run(tmp_path, "rgb_default")
    path = run / "metrics.csv"
    header = "update,step,wall_time,return,success"
    # One lucky buffer is not enough; five in which half succeed are.
    rates = [0.0, 1.0, 0.0, 0.0, 0.0, 0.4, 0.4, 0.6, 0.6, 0.5, 0.9]
    lines = [f"{i},{i * BUFFER},{i},1.0,{rate}" for i, rate in enumerate(rates, start=1)]
    path.write_text("\n".join([header, *lines, ""]))
    (record,) = read_study(tmp_path).runs
    assert steps_to_share(record, "success", 0.5) == 10 * BUFFER
    assert steps_to_share(record, "success", 0.95) is None


def test_the_papers_numbers_draw_before_a_single_run(sketched, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["plot", "paper"]) == 0
    assert "results/paper/figures/final_values.png" in capsys.readouterr().out
    with styled():
        axes = final_values(paper_findings(Path("nowhere"))).axes[0]
    assert axes.get_title("left") == "As published in the paper"
    assert axes.get_xlabel() == "final return\n(one seed, no interval)"
    assert len(axes.patches) == 14


def test_values_without_an_interval_say_of_how_many_seeds_they_are(tmp_path):
    write_study(tmp_path / "main", [("dep_front", "human"), ("seg_side", "human")], seeds=2)
    both = final_values(study_findings(tmp_path / "main")).axes[0]
    assert both.get_xlabel() == "final return\n(2 seeds, no interval)"
    write_run(tmp_path / "main", "rgb_default")
    mixed = final_values(study_findings(tmp_path / "main")).axes[0]
    assert mixed.get_xlabel() == "final return\n(at most 2 seeds, no interval)"


def test_a_study_without_values_is_an_error_that_names_why(tmp_path, capsys):
    run = write_run(tmp_path / "main", "rgb_default", updates=20)
    (run / "config.yaml").write_text("")
    assert main(["plot", str(tmp_path / "main")]) == 2
    error = capsys.readouterr().err
    assert "no run with a final value yet" in error
    assert "its config.yaml is empty" in error
    assert main(["plot", str(tmp_path / "main"), "size=3"]) == 2
    assert "'size=3' is not understood" in capsys.readouterr().err
