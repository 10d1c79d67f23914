"""``needlehoop watch``: fresh episodes of a trained agent, as a film."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import imageio.v2 as imageio
import pytest
from tiny_runs import contents

from needlehoop.cli.main import main
from needlehoop.runs import shipped

pytestmark = pytest.mark.usefixtures("elsewhere")


@pytest.fixture(scope="module")
def run(tiny_run, tmp_path_factory) -> Path:
    """A run's folder as it is shipped: with its weights and without its checkpoint."""
    leave = shutil.ignore_patterns("checkpoint.pt")
    return shutil.copytree(tiny_run, tmp_path_factory.mktemp("watched") / "seed0", ignore=leave)


def frames(path: Path) -> int:
    with imageio.get_reader(path) as video:
        return video.count_frames()


def test_the_shipped_agent_is_watched_if_none_is_named(run, monkeypatch, capsys):
    before = contents(run)
    monkeypatch.setattr(shipped, "AGENT", run)
    for shown in (1, 2):
        words = ["episodes=4", f"video_episodes={shown}", "episode.max_steps=4"]
        assert main(["watch", *words]) == 0
        output = capsys.readouterr().out
        assert str(run) in output
        # Not the seed of its own evaluation.
        assert "episodes     4 (seed 1000002)" in output
    # The first film is kept.
    assert frames(Path("watch.mp4")) == 2 * frames(Path("watch.1.mp4"))
    assert contents(run) == before


@pytest.mark.parametrize(
    ("word", "cameras"),
    [
        ("task=reach/near", "dep_front+seg_side"),
        pytest.param("task=peg_transfer", "dep_front+seg_side", marks=pytest.mark.full),
        pytest.param("task=handover", "rgb_front+rgb_side", marks=pytest.mark.full),
    ],
)
def test_a_task_has_a_shipped_agent_of_its_own(word, cameras, capsys):
    assert main(["watch", word, "episodes=2", "video_episodes=1", "--json"]) == 0
    evaluation = json.loads(capsys.readouterr().out)
    task = word.removeprefix("task=").partition("/")[0]
    assert evaluation["run"].endswith(f"results/{task}/{cameras}/expert/seed0")
    assert ("changed" in evaluation) == ("/" in word)
    assert evaluation["success"] == 1.0
