"""A run of a view of one's own: its config is enough for whatever takes a run."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from tiny_runs import TINY, run_train

from needlehoop.cli.main import main
from needlehoop.runs.shipped import CONF


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with ``conf/`` and the results of a run that was paused and resumed."""
    place = tmp_path_factory.mktemp("own_view")
    view = yaml.safe_load((CONF / "view/front.yaml").read_text())
    (place / "conf/view").mkdir(parents=True)
    (place / "conf/view/near.yaml").write_text(yaml.safe_dump({**view, "azimuth": 20.0}))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        words = [*TINY, "cams=rgb_near", "obs=images", "reward=human", "image_size=16"]
        run_train("conf_dir=conf", *words, "until=16")
        run_train("resume=results/main/rgb_near/human/seed0")
    return place


RUN = "results/main/rgb_near/human/seed0"


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["evaluate", RUN], "the same as"),
        (["evaluate", RUN, "views.near.azimuth=25"], "changed      views.near.azimuth=25"),
        (["watch", RUN, "episodes=1", "video_episodes=1"], "watch.mp4"),
        (["export", "what=policy", f"run={RUN}"], "MB, last, after 24 steps"),
    ],
    ids=lambda words: " ".join(words)[:60] if isinstance(words, list) else "",
)
@pytest.mark.full
def test_a_command_takes_its_run(place, monkeypatch, capsys, words, output):
    monkeypatch.chdir(place)
    assert main(words) == 0, capsys.readouterr().err
    assert output in capsys.readouterr().out
