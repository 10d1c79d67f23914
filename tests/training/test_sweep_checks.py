"""What is said about a sweep before its first run."""

from __future__ import annotations

import pytest
from tiny_runs import run_train

from needlehoop.cli.main import main
from needlehoop.training import sweep


@pytest.fixture
def started(monkeypatch, tmp_path) -> list[str]:
    """The runs that were started, which do nothing, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    runs: list[str] = []
    monkeypatch.setattr(sweep, "attempt", lambda run, folder, note: runs.append(note["run"]))
    return runs


@pytest.mark.full
def test_missing_programs_are_named_at_once_and_nothing_is_made(started, tmp_path):
    with pytest.raises(SystemExit) as caught:
        run_train("-m", "+experiment=table2", "reward=vlm_img", "seed=0,1", "study=s")
    assert started == []
    assert list(tmp_path.iterdir()) == []
    first, *missing = str(caught.value.code).splitlines()
    assert first.startswith("nothing was started")
    # Of the paper's 14 combinations, 3 have a program in its recording.
    assert len(missing) == 11
    asking = "needlehoop vlm reward 'cams=[rgb_default]' flavour=image study=s vlm=gemini"
    assert missing[0].endswith(f"make one with: {asking}")


def test_a_program_that_is_refused_is_named_too(started, tmp_path):
    (tmp_path / "mine.txt").write_text("reward = nonsense(1)")
    words = ["-m", "cams=[dep_front],[seg_side]", "reward=file", "reward.path=mine.txt"]
    with pytest.raises(
        SystemExit, match=r"nothing was started(.|\n)*mine.txt, line 1.*no function"
    ):
        run_train(*words)
    assert started == []
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["cams=[rgb_top],[seg_side]"], "cams/rgb_top.*dep_default dep_ecm_left"),
        (
            ["cams=[seg_side],[dep_front]", "algo.minibatch=64,0"],
            "algo.minibatch: 0 must be at least 1",
        ),
        (["cams=[seg_side],[dep_front]", "reward=human,nope"], "reward/nope.*human python sparse"),
    ],
)
def test_a_mistake_in_one_run_stops_all(started, tmp_path, words, said):
    with pytest.raises(SystemExit, match=said) as caught:
        run_train("-m", *words)
    assert "\n" not in str(caught.value.code)
    assert started == list(tmp_path.iterdir()) == []


@pytest.mark.full
def test_an_install_trains_with_the_same_command(started, monkeypatch, capfd):
    monkeypatch.setattr("sys.argv", ["needlehoop"])
    with pytest.raises(SystemExit):
        main(["train", "-m", "cams=[dep_front],[seg_side]", "seed=0,1"])
    assert len(started) == 4
    with pytest.raises(SystemExit, match="needlehoop train: stpes: unknown key"):
        main(["train", "cams=dep_front", "stpes=9"])
    with pytest.raises(SystemExit) as caught:
        main(["train", "--help"])
    assert caught.value.code == 0
    assert "sweep over single cameras" in capfd.readouterr().out
