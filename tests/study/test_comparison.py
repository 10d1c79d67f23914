"""Studies with other settings, and single runs, beside each other."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from study_files import change, rows_of, write_run

from needlehoop.cli.main import main
from needlehoop.study.data.records import Place, read_run, read_study
from needlehoop.study.report.comparison import (
    compared_runs,
    comparisons,
    differences,
    outcomes,
)


@pytest.fixture
def two(tmp_path) -> tuple[Path, Path]:
    """``a``: three seeds; ``b``: three with another reward unit and 70 points less success."""
    for seed in range(3):
        a, b = (write_run(tmp_path / name, "rgb_default", seed=seed) for name in "ab")
        change(a / "evaluation.json", success=0.8 + 0.1 * seed)
        change(b / "evaluation.json", success=0.1 + 0.1 * seed)
        change(b / "config.yaml", reward={"kind": "human", "unit": 0.1})
    return tmp_path / "a", tmp_path / "b"


@pytest.fixture
def runs(tmp_path) -> tuple[Path, Path]:
    """Two runs of one study: 90 and 70 of 100 episodes succeed."""
    first, second = (write_run(tmp_path / "main", "rgb_default", seed=seed) for seed in (0, 1))
    change(first / "evaluation.json", success=0.9, return_sd=2.0, **{"return": 8.0})
    change(second / "evaluation.json", success=0.7, return_sd=1.0, **{"return": 7.0})
    return first, second


def test_studies_differ_by_an_interval_over_their_seeds(two):
    groups = comparisons([read_study(folder) for folder in two])
    first, second = rows_of(outcomes(groups, "study"))
    assert (first["study"], first["difference of success, %"]) == ("a", "")
    assert second["difference of success, %"].startswith("-70 (")
    assert second["success, 95 %"] == "0 to 45"


def test_settings_that_differ_are_listed_and_no_others(two):
    change(two[0] / "rgb_default" / "human" / "seed1" / "config.yaml", num_envs=40)
    rows = rows_of(differences(comparisons([read_study(folder) for folder in two])))
    settings = {row["setting"]: (row["a"], row["b"]) for row in rows}
    assert settings == {"reward.unit": ("", "0.1"), "num_envs": ("80 / 40", "80")}


def test_runs_differ_by_an_interval_over_their_episodes(runs):
    group = compared_runs([read_run(run).runs[0] for run in runs])
    assert [*group] == ["seed0", "seed1"]
    first, second = rows_of(outcomes([group], "run"))
    assert (first["difference of success, %"], first["difference of return"]) == ("", "")
    # Newcombe's of 90 and 70 of 100: -0.20 (-0.31 to -0.09).
    assert second["difference of success, %"] == "-20 (-31 to -9)"
    # 1.96 * sqrt(2 ** 2 / 100 + 1 ** 2 / 100).
    assert second["difference of return"] == "-1.00 (-1.44 to -0.56)"
    assert rows_of(differences([group])) == [{"setting": "seed", "seed0": "0", "seed1": "1"}]


def test_returns_of_another_reward_are_not_compared(runs):
    (other,), (second,) = read_run(runs[0]).runs, read_run(runs[1]).runs
    other = replace(other, place=Place("rgb_default", "sparse", 0))
    _, row = rows_of(outcomes([compared_runs([other, second])], "run"))
    assert row["difference of return"] == ""
    assert row["difference of success, %"] != ""


def test_runs_are_compared_on_a_page_that_needs_nothing_else(runs, capsys):
    (runs[1] / "video.mp4").write_bytes(b"a film")
    assert main(["compare", *map(str, runs)]) == 0
    assert "-20 (-31 to -9)" in capsys.readouterr().out
    folder = runs[0].parent / "seed0_vs_seed1"
    assert {path.name for path in folder.iterdir()} == {
        *(f"{name}.{kind}" for name in ("settings", "evaluations") for kind in ("csv", "md")),
        "comparison.html",
        "rgb_default_human.png",
    }
    text = (folder / "comparison.html").read_text()
    assert "-20 (-31 to -9)" in text
    assert text.count("data:image/png;base64,") == 1
    assert text.count("data:video/mp4;base64,") == 1
    assert not re.search(r'(?:src|href)="(?!data:)', text)


def test_what_cannot_be_compared_is_said(two, capsys, monkeypatch):
    monkeypatch.chdir(two[0].parent)
    write_run(Path("other"), "dep_default")
    for words, message in (
        (["a"], "a; name two or more"),
        (["a", "other"], "no cameras and reward that two of them have\n  rgb_default/human: a"),
        (["a/rgb_default/human/seed0", "b"], "seed0 is a run, and others are studies"),
    ):
        assert main(["compare", *words]) == 2
        assert message in capsys.readouterr().err
        assert not list(Path().rglob("*.html"))
