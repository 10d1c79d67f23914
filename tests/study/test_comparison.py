"""Studies with other settings, and single runs, beside each other."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.colors import to_hex
from study_files import BUFFER, texts_of, write_run

from needlehoop.cli import main as cli
from needlehoop.study.data.records import Place, read_run, read_study
from needlehoop.study.report.comparison import (
    compared_runs,
    comparison_chart,
    comparisons,
    differences,
    outcomes,
    progress,
)


def learnt(study: Path, seed: int, begins: int, buffers: int) -> Path:
    """A run that threads in no episode, then from buffer ``begins`` on in all."""
    run = write_run(study, "rgb_default", seed=seed)
    header = "update,step,wall_time,return,success,threaded,lifted"
    lines = [
        f"{i},{i * BUFFER},{i},{i / 10},{share},{share},1.0"
        for i in range(1, buffers + 1)
        for share in [float(i >= begins)]
    ]
    (run / "metrics.csv").write_text("\n".join([header, *lines, ""]))
    return run


def change(run: Path, **values: object) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text())
    (run / "config.yaml").write_text(yaml.safe_dump({**config, **values}))


@pytest.fixture
def two(tmp_path) -> tuple[Path, Path]:
    """``a``: two seeds of 40 buffers; ``b``: one of 30, with another reward unit."""
    a, b = tmp_path / "a", tmp_path / "b"
    learnt(a, 0, 20, 40)
    learnt(a, 1, 35, 40)
    change(learnt(b, 0, 10, 30), reward={"kind": "human", "unit": 0.1})
    return a, b


def opened(*folders: Path) -> list:
    return comparisons([read_study(folder) for folder in folders])


def test_progress_says_when_each_run_got_how_far(two):
    (found,) = opened(*two)
    assert (found.title, list(found.runs)) == ("rgb_default, human", ["a", "b"])
    assert found.steps == 30 * BUFFER
    rows = texts_of(progress([found]))
    assert [(row["study"], row["seed"]) for row in rows] == [("a", "0"), ("a", "1"), ("b", "0")]

    def at(buffer: int) -> str:
        return f"{buffer * BUFFER / 1e6:.2f}"

    # Of five buffers the third makes a half, and the last all of them.
    assert [row["half threaded, M steps"] for row in rows] == [at(22), at(37), at(12)]
    assert [row["95 % threaded, M steps"] for row in rows] == [at(24), at(39), at(14)]
    assert [row["half lifted, M steps"] for row in rows] == [at(5)] * 3
    # No run has this column.
    assert [row["half grasped, M steps"] for row in rows] == [""] * 3
    # The shortest has 30 buffers; all are compared there.
    assert [row["compared after, M steps"] for row in rows] == [at(30)] * 3
    assert [row["threaded, %"] for row in rows] == ["100", "0", "100"]
    assert [row["return"] for row in rows] == ["2.80"] * 3


def test_settings_that_differ_are_listed_and_no_others(two):
    a, b = two
    change(a / "rgb_default" / "human" / "seed1", num_envs=40)
    rows = texts_of(differences(opened(a, b)))
    found = {row["setting"]: (row["a"], row["b"]) for row in rows}
    assert found == {"reward.unit": ("", "0.1"), "num_envs": ("80 / 40", "80")}


def test_a_chart_has_a_line_for_each_study_in_each_panel(two):
    figure = comparison_chart(opened(*two)[0])
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "share lifted in training",
        "share threaded in training",
        "return in training",
    ]
    for axes in figure.axes:
        named = [text.get_text() for text in axes.get_legend().get_texts()]
        assert sorted(named) == ["a", "b"]
        colours = {to_hex(str(line.get_color())) for line in axes.lines}
        assert len(colours) == 2
    drawn = [np.asarray(line.get_xydata(), dtype=float) for line in figure.axes[1].lines]
    # The other lines lead to the names.
    ends = [points[~np.isnan(points[:, 1])][-1, 0] for points in drawn if len(points) > 2]
    assert max(ends) == pytest.approx(40 * BUFFER / 1e6)


def test_the_command_writes_tables_and_figures_beside_the_studies(two, capsys):
    a, b = two
    assert cli.main(["compare", str(a), str(b)]) == 0
    out = capsys.readouterr().out
    assert "What differs" in out
    assert "Progress in training" in out
    folder = a.parent / "a_vs_b"
    tables = ("settings", "evaluations", "progress")
    assert str(folder / "comparison.html") in out
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.{kind}" for name in tables for kind in ("csv", "md", "tex")),
        "comparison.html",
        "rgb_default_human.png",
        "rgb_default_human.svg",
    }


def test_what_cannot_be_compared_is_said(two, capsys, monkeypatch):
    monkeypatch.chdir(two[0].parent)
    write_run(Path("other"), "dep_default")
    learnt(Path("deep/c"), 0, 10, 20)
    for words, said in (
        (["a"], "a alone; name two or more"),
        (["a", "a"], "a, a are not different names"),
        (["a", "nowhere"], "nowhere: no such folder"),
        (["a", "other"], "no cameras and reward that two of them have\n  rgb_default/human: a"),
        (["a", "seed=1"], "seed=1: no such folder"),
        (["a/rgb_default/human/seed0"], "name two or more, each once"),
        (["a/rgb_default/human/seed0", "b"], "seed0 is a run, and others are studies"),
    ):
        assert cli.main(["compare", *words]) == 2
        assert said in capsys.readouterr().err
        assert not list(Path().rglob("*.html"))


def evaluated(run: Path, **values: object) -> None:
    """Write a run's long evaluation anew."""
    path = run / "evaluation.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    facts = dict.fromkeys(("cheat", "grasped", "lifted", "threaded", "diverged"), 0.0)
    path.write_text(json.dumps({**found, "episodes": 100, **facts, "return": 1.0, **values}))
    manifest = json.loads((run / "manifest.json").read_text())
    (run / "manifest.json").write_text(json.dumps({**manifest, "finished": True}))


@pytest.fixture
def runs(tmp_path) -> tuple[Path, Path]:
    """Two runs of one study: 90 and 70 of 100 episodes succeed."""
    study = tmp_path / "main"
    first, second = learnt(study, 0, 20, 40), learnt(study, 1, 30, 40)
    evaluated(first, success=0.9, return_sd=2.0, **{"return": 8.0})
    evaluated(second, success=0.7, return_sd=1.0, **{"return": 7.0})
    return first, second


def test_runs_differ_by_an_interval_over_their_episodes(runs):
    found = compared_runs([read_run(run).runs[0] for run in runs])
    assert list(found.runs) == ["seed0", "seed1"]
    first, second = texts_of(outcomes([found], "run"))
    assert first["success, %"] == "90 (83 to 94)"
    assert (first["difference of success, %"], first["difference of return"]) == ("", "")
    # Newcombe's of 90 and 70 of 100: -0.20 (-0.31 to -0.09).
    assert second["difference of success, %"] == "-20 (-31 to -9)"
    # 1.96 * sqrt(2 ** 2 / 100 + 1 ** 2 / 100).
    assert second["difference of return"] == "-1.00 (-1.44 to -0.56)"
    assert second["intervals"] == "over episodes"
    assert texts_of(differences([found], "run")) == [
        {"setting": "seed", "seed0": "0", "seed1": "1"}
    ]


def test_returns_of_another_reward_are_not_compared(runs):
    (other,), (second,) = read_run(runs[0]).runs, read_run(runs[1]).runs
    other = replace(other, place=Place("rgb_default", "sparse", 0))
    _, row = texts_of(outcomes([compared_runs([other, second])], "run"))
    assert row["difference of return"] == ""
    assert row["difference of success, %"] != ""


def test_the_difference_of_three_seeds_is_over_seeds(tmp_path):
    for name, shares in (("a", (0.8, 0.9, 1.0)), ("b", (0.1, 0.2, 0.3))):
        for seed, share in enumerate(shares):
            evaluated(learnt(tmp_path / name, seed, 20, 40), success=share)
    _, row = texts_of(outcomes(opened(tmp_path / "a", tmp_path / "b"), "study"))
    assert row["difference of success, %"].startswith("-70 (")
    assert row["intervals"] == "over seeds"


def test_runs_are_compared_on_a_page_that_needs_nothing_else(runs, capsys):
    (runs[1] / "video.mp4").write_bytes(
        b"".join((8).to_bytes(4, "big") + name for name in (b"ftyp", b"moov"))
    )
    assert cli.main(["compare", *map(str, runs)]) == 0
    page = runs[0].parent / "seed0_vs_seed1" / "comparison.html"
    assert str(page.name) in capsys.readouterr().out
    text = page.read_text()
    assert "-20 (-31 to -9)" in text
    assert text.count("data:image/svg+xml;base64,") == 1
    assert text.count("data:video/mp4;base64,") == 1
    assert "seed=1  # seed1" in text
    assert not re.search(r'(?:src|href)="(?!data:)', text)
