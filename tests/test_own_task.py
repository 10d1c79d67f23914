"""A task from outside: the example obeys the contract, and what is wrong with one is said."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import gymnasium
import pytest
import torch
from strength import ALL
from tiny_runs import refusal, run_train

import needlehoop
from needlehoop.cli.main import main
from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.simulation import Simulation
from needlehoop.tasks import registry

FOLDER = Path(__file__).parents[1] / "examples/own_task"


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    """What a test imports, the next does not know."""
    monkeypatch.setattr(registry, "_added", {})


def built(*words: str) -> Simulation:
    return build(compose_settings([f"task_dir={FOLDER}", *words]))


def expert_of(simulation: Simulation):
    task = registry.find("cube_on_spot")
    return task.controllers["expert"](simulation.layout, simulation.episode)


def test_the_expert_puts_the_cube_on_the_spot():
    simulation = built(f"num_envs={200 if ALL else 50}", "seed=4000")
    act, moment = expert_of(simulation), simulation.reset()
    assert not moment.facts["success"].any()
    done = moment.facts["success"].clone()
    for _ in range(simulation.episode.max_steps):
        moment = simulation.step(act(moment.signals))
        now = moment.facts["success"]
        assert (moment.potential[now] > 6.0).all()
        assert (moment.potential[~now] < 4.0).all()
        done |= now
        if bool(done.all()):
            break
    assert done.double().mean() >= 0.99


def test_a_cube_held_over_the_spot_is_not_placed():
    simulation = built("num_envs=6")
    act, moment = expert_of(simulation), simulation.reset()
    for _ in range(simulation.episode.max_steps):
        action = act(moment.signals)
        # It never lets go of what it holds.
        action[:, 3] = torch.where(moment.signals.held, -1.0, action[:, 3])
        moment = simulation.step(action)
        assert not moment.facts["success"].any()
    assert moment.facts["has_held"].all()


# Everything takes it.


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The folder of an agent that imitated the expert for a moment."""
    results = tmp_path_factory.mktemp("own")
    run_train(
        *("algo=dagger", f"task_dir={FOLDER}", f"results={results}", "obs=signals", "num_envs=8"),
        *("steps=160", "algo.minibatches=1", "algo.network.hidden=16", "engine.threads=1"),
        *("evaluation.every=0", "evaluation.final_episodes=1", "evaluation.video_episodes=0"),
    )
    return results / "main/signals/expert/seed0"


def test_a_run_s_files_import_it_with_trust_alone(run, tmp_path, capsys):
    words = ["evaluate", str(run), "episodes=4", "video=false", "--json"]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "'cube_on_spot' of" in error
    assert "trust=true" in error
    assert error.count("\n") == 1
    # A finished run is refused before anything of it is read.
    assert "is finished" in refusal(f"resume={run}")
    unfinished = tmp_path / run.name
    shutil.copytree(run, unfinished)
    manifest = json.loads((unfinished / "manifest.json").read_text())
    (unfinished / "manifest.json").write_text(json.dumps({**manifest, "finished": False}))
    assert "trust=true" in refusal(f"resume={unfinished}")
    with pytest.raises(ValueError, match="trust=true"):
        needlehoop.make_env_of(run)
    assert registry.names() == registry.built_in()
    # A policy needs no task.
    assert needlehoop.load_policy(run)
    assert registry.names() == registry.built_in()
    assert main([*words, "trust=true"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 4
    needlehoop.make_env_of(run, num_envs=1, trust=True).reset()


def test_environments_take_it():
    env = needlehoop.make_env(num_envs=2, task_dir=FOLDER, overrides=["obs.signals=true"])
    assert env.reset()["signals"].shape == (2, 12)
    made = gymnasium.make("needlehoop/OwnTask-v0", cams=[], obs="signals", task_dir=FOLDER)
    assert made.reset(seed=3)[1]["facts"] == dict.fromkeys(
        ("held", "placed", "success", "has_held", "diverged"), False
    )


def test_commands_take_it(capsys, tmp_path):
    word = f"task_dir={FOLDER}"
    assert main(["tasks", word]) == 0
    output = capsys.readouterr().out
    assert "cube_on_spot: A gantry" in output
    assert "grip_command" in output
    assert "needle_hoop: " not in output
    assert main(["tasks", word, "task=cube_on_spot"]) == 0
    assert "grip_command" in capsys.readouterr().out
    assert main(["export", word, f"out={tmp_path}/arm"]) == 2
    assert "cube_on_spot does not have one PSM" in capsys.readouterr().err


def test_a_model_is_asked_about_it(capsys, tmp_path):
    words = ["vlm=manual", "vlm.model=claude", "vlm.wait=0", f"results={tmp_path}"]
    for command in (["question"], ["reward", "cams=dep_front"]):
        assert main(["vlm", *command, f"task_dir={FOLDER}", *words]) == 2
        assert "no answer yet" in capsys.readouterr().err
    requests = [file.read_text() for file in tmp_path.rglob("request.md")]
    assert len(requests) == 2
    for text in requests:
        assert "A cube with an edge of 10 mm" in text
        assert not re.search("needle|hoop|jaw", text)
    assert any("held            scalar" in text and "placed" not in text for text in requests)


# What is wrong is said in a line.


@pytest.fixture
def copied(tmp_path) -> Path:
    return Path(shutil.copytree(FOLDER, tmp_path / "mine"))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('goal="placed"', 'goal="palced"', "goal: no 'palced' among held, placed"),
        ('name="cube_on_spot"', 'name="reach"', "the name 'reach' is taken"),
        ("from .expert", "from .exprt", "No module named"),
    ],
)
def test_a_task_that_leaves_something_out_is_refused(copied, before, after, message):
    file = copied / "__init__.py"
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after))
    with pytest.raises(ValueError, match=message) as caught:
        compose_settings([f"task_dir={copied}"])
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_none_is_named(copied, tmp_path):
    with pytest.raises(ValueError, match=r"task_dir: .*nowhere/conf' is no folder"):
        compose_settings([f"task_dir={tmp_path}/nowhere"])
    (copied / "conf/task/other.yaml").write_text("name: cube_on_spot\n")
    with pytest.raises(ValueError, match=r"which task=\? choose from cube_on_spot, other"):
        compose_settings([f"task_dir={copied}"])
    assert compose_settings([f"task_dir={copied}", "task=cube_on_spot"]).task.name == "cube_on_spot"
    with pytest.raises(ValueError, match="task: 'reach' was chosen"):
        compose_settings([f"task_dir={copied}", "task=reach"])
    (copied / "conf/reward/human.yaml").write_text("kind: human\n")
    with pytest.raises(ValueError, match=r"task_dir: reward/human\.yaml: the name is taken"):
        compose_settings([f"task_dir={copied}"])


def test_an_installed_package_has_a_task(tmp_path, monkeypatch):
    shutil.copytree(FOLDER, tmp_path / "my_package")
    info = tmp_path / "my_package-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1\n")
    (info / "entry_points.txt").write_text(f"[{registry.TASKS}]\ncube_on_spot = my_package:TASK\n")
    monkeypatch.syspath_prepend(tmp_path)
    settings = compose_settings(["task=cube_on_spot", "num_envs=1"])
    assert settings.definition.name == "cube_on_spot"
    assert settings.reward["kind"] == "human"
    assert build(settings).reset()
