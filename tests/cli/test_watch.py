"""``needlehoop watch``: fresh episodes of a trained agent, as a film or in a window."""

from __future__ import annotations

import contextlib
import json
import shutil
import sys
from pathlib import Path

import imageio.v2 as imageio
import pytest

from needlehoop.cli.main import main
from needlehoop.pictures import window
from needlehoop.runs import shipped


@pytest.fixture(scope="module")
def run(tiny_run, tmp_path_factory) -> Path:
    """A run's folder as it is shipped: with its weights and without its checkpoint."""
    leave = shutil.ignore_patterns("checkpoint.pt")
    return shutil.copytree(tiny_run, tmp_path_factory.mktemp("watched") / "seed0", ignore=leave)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """An empty folder, and no display."""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def frames(path: Path) -> int:
    with imageio.get_reader(path) as video:
        return video.count_frames()


def test_the_shipped_agent_is_watched_if_none_is_named(run, monkeypatch, capsys):
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    monkeypatch.setattr(shipped, "AGENT", run)
    for shown in (1, 2):
        assert main(["watch", "episodes=4", f"video_episodes={shown}"]) == 0
        said = capsys.readouterr().out
        assert str(run) in said
        # Not the seed of its own evaluation.
        assert "episodes     4 (seed 1000002)" in said
    # The first film is kept.
    assert frames(Path("watch.mp4")) == 2 * frames(Path("watch.1.mp4"))
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


@pytest.mark.parametrize(
    "word", ["task=reach/near", pytest.param("task=peg_transfer", marks=pytest.mark.full)]
)
def test_a_task_has_a_shipped_agent_of_its_own(word, capsys):
    assert main(["watch", word, "episodes=2", "video_episodes=1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    task = word.removeprefix("task=").partition("/")[0]
    assert found["run"].endswith(f"results/{task}/dep_front+seg_side/expert/seed0")
    assert ("changed" in found) == ("/" in word)
    assert found["success"] == 1.0


class Viewer:
    """Stands in for MuJoCo's window; ``patience`` is when somebody closes it."""

    def __init__(self, data, patience):
        self.data, self.seen, self.patience, self.is_open = data, [], patience, True

    def is_running(self):
        return self.is_open and len(self.seen) < self.patience

    def lock(self):
        return contextlib.nullcontext()

    def sync(self):
        self.seen.append(self.data.time)

    def close(self):
        self.is_open = False


@pytest.mark.parametrize(("patience", "shown"), [(100, 8), (3, 3)])
def test_where_there_is_a_display_a_window_shows_it(run, monkeypatch, capsys, patience, shown):
    opened = []

    def open_window(model, data, view):
        opened.append(Viewer(data, patience))
        return opened[-1]

    monkeypatch.setenv("DISPLAY", ":7")
    monkeypatch.setattr(window, "_opens", lambda *_: True)
    monkeypatch.setattr(window, "open_window", open_window)
    assert main(["watch", str(run), "episodes=1", "video_episodes=2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 1
    (viewer,) = opened
    # Two episodes of three steps, each with its start.
    assert len(viewer.seen) == shown
    assert viewer.seen[0] < viewer.seen[1] < viewer.seen[2]
    assert not viewer.is_open
    assert list(Path().iterdir()) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the displays of X")
def test_a_display_that_is_gone_is_none(run, monkeypatch, capsys):
    # As a terminal on a cluster names it after its connection has ended.
    monkeypatch.setenv("DISPLAY", "localhost:99.0")
    assert main(["watch", str(run), "episodes=1", "window=true"]) == 2
    assert "no display (DISPLAY=localhost:99.0 opens no window" in capsys.readouterr().err
    assert main(["watch", str(run), "episodes=1", "video_episodes=1"]) == 0
    assert Path("watch.mp4").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["window=true"], "no display"),
        (["video_episodes=0"], "video_episodes: 0"),
        (["episodes=0"], "episodes: 0"),
        (["out=watch.gif"], ".mp4"),
        (["seed=0"], "trained on"),
        (["episods=1"], "episods: unknown key"),
    ],
)
def test_what_cannot_be_watched_is_refused(run, capsys, words, said):
    assert main(["watch", str(run), *words]) == 2
    assert said in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_a_folder_that_is_no_run_is_refused(tmp_path, capsys):
    assert main(["watch", str(tmp_path)]) == 2
    assert "is no run" in capsys.readouterr().err
