"""A run of a view of one's own: its config is enough for whatever takes a run."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from tiny_runs import run_train

from needlehoop.cli.main import main
from needlehoop.runs.shipped import CONF

TINY = ["cams=rgb_near", "steps=64", "num_envs=4", "algo.horizon=8", "algo.minibatch=16"]
TINY += ["image_size=16", "episode.max_steps=6", "evaluation.every=1", "evaluation.episodes=1"]
TINY += ["evaluation.final_episodes=2", "evaluation.video_episodes=0", "engine.threads=1"]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with ``conf/`` and the results of a run that was paused and resumed."""
    place = tmp_path_factory.mktemp("own_view")
    view = yaml.safe_load((CONF / "view/front.yaml").read_text())
    (place / "conf/view").mkdir(parents=True)
    (place / "conf/view/near.yaml").write_text(yaml.safe_dump({**view, "azimuth": 20.0}))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        run_train("conf_dir=conf", *TINY, "until=32")
        run_train("resume=results/main/rgb_near/human/seed0")
    return place


RUN = "results/main/rgb_near/human/seed0"


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (["evaluate", RUN], "the same as"),
        (["evaluate", RUN, "views.near.azimuth=25"], "changed      views.near.azimuth=25"),
        (["evaluate", RUN, "reward=sparse", "policy=best"], "policy       best, after"),
        (["watch", RUN, "episodes=1", "video_episodes=1"], "watch.mp4"),
        (["report", "results/main"], "report.html"),
        (["export", "what=policy", f"run={RUN}"], "MB, last, after 64 steps"),
        (
            [
                *("demonstrations", f"demonstrator={RUN}", "episodes=1", "out=e", "format=lerobot"),
                *("episode.max_steps=2", "seed=3"),
            ],
            "e: 1 episodes (seed 3), 2 steps",
        ),
    ],
    ids=lambda words: " ".join(words)[:60] if isinstance(words, list) else "",
)
@pytest.mark.full
def test_a_command_takes_its_run(place, monkeypatch, capsys, words, output):
    monkeypatch.chdir(place)
    assert main(words) == 0, capsys.readouterr().err
    assert output in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["episodes=1"], "out: give a folder for the dataset, such as out=demos/smooth-v0"),
        (["out=f-v0", "cams=[rgb_front]"], "cams: the agent's networks take what the run sees"),
    ],
)
def test_demonstrations_of_a_run_refuse_in_a_line(place, monkeypatch, capsys, words, message):
    monkeypatch.chdir(place)
    assert main(["demonstrations", f"demonstrator={RUN}", *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not Path("f-v0").exists()
