"""Cameras, renderings, tasks and rewards from outside the package."""

import pytest
import torch
import yaml
from needle_task import load_reward

import needlehoop
from needlehoop import rewards
from needlehoop.cli.main import main
from needlehoop.config import composing
from needlehoop.envs.settings import compose_settings
from needlehoop.runs.files import reward_name

VIEW = {**yaml.safe_load((composing.CONF / "view/front.yaml").read_text()), "azimuth": 20.0}


@pytest.fixture
def folder(tmp_path):
    """A config folder of one's own, with a space in its name."""
    conf = tmp_path / "my conf"
    for name, values in (
        ("view/left", VIEW),
        ("rendering/hoop", {"colour": "flat", "depth": "none", "colours": {"hoop": [9, 9, 9]}}),
        ("task/tight", {"defaults": ["standard", "_self_"], "hoop_opening": 0.0085}),
        ("reward/mine", {"defaults": ["human", "_self_"], "lift": 5.0}),
    ):
        (conf / name).parent.mkdir(parents=True)
        (conf / f"{name}.yaml").write_text(yaml.safe_dump(values))
    return conf


def half(signals, most=4.0):
    """Pays for a closed jaw."""
    return {"jaw": most * (1.35 - signals.jaw_command), "held": signals.grasped}


def test_a_folder_s_files_are_options_beside_ours(folder):
    words = ["cams=rgb_left,hoop_front,hoop_left,seg_side", "task=tight", "reward=mine"]
    settings = compose_settings([f"conf_dir={folder}", *words])
    assert settings.cams == ("rgb_left", "hoop_front", "hoop_left", "seg_side")
    assert settings.views["left"].azimuth == 20.0
    assert settings.task.hoop_opening == 0.0085
    assert settings.task.hoop_tube == compose_settings().task.hoop_tube
    assert settings.reward["lift"] == 5.0
    env = needlehoop.make_env("hoop_left,seg_side", num_envs=1, conf_dir=folder)
    assert env.settings.cams == ("hoop_left", "seg_side")
    assert set(env.reset()["pixels", "hoop_left"].unique().tolist()) == {0, 9}
    # What one call was told, the next does not know.
    with pytest.raises(ValueError, match="rgb_left"):
        compose_settings(["cams=rgb_left"])


def test_commands_and_training_take_it(folder, tmp_path, capsys, monkeypatch):
    out = tmp_path / "sheet.png"
    assert main(["snapshot", f"conf_dir={folder}", "size=16", "raw=true", f"out={out}"]) == 0
    assert "sheet.png" in capsys.readouterr().out
    assert main(["snapshot", "conf_dir=nowhere"]) == 2
    assert "no folder" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["train.py"])
    words = [f"conf_dir={folder}", "cams=hoop_left", "reward=mine", "--cfg", "job"]
    main(["train", *words])
    values = yaml.safe_load(capsys.readouterr().out)
    assert list(values["cameras"]) == ["hoop_left"]
    assert values["views"]["left"]["azimuth"] == 20.0
    assert values["reward"]["lift"] == 5.0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("views/top", "conf_dir: 'views' is no group; choose from .*rendering.*view"),
        ("view/wrist", "conf_dir: view/wrist.yaml: the name is taken"),
    ],
)
def test_what_would_be_left_aside_is_refused(tmp_path, name, message):
    (tmp_path / name).parent.mkdir()
    (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(VIEW))
    with pytest.raises(ValueError, match=message):
        compose_settings([f"conf_dir={tmp_path}"])


def test_a_file_cannot_name_a_task_s_folder_and_a_bad_one_is_named(tmp_path):
    """The folder of a task is imported."""
    (tmp_path / "experiment").mkdir()
    for text, message in (
        ("# @package _global_\ntask_dir: /tmp/evil\n", "task_dir counts only where you type it"),
        ("- 3\n", "theirs.yaml holds no keys"),
    ):
        (tmp_path / "experiment/theirs.yaml").write_text(text)
        with pytest.raises(ValueError, match=message):
            composing.compose([f"conf_dir={tmp_path}", "+experiment=theirs"], "config")


def test_a_function_is_a_reward():
    env = needlehoop.make_env(reward=half, num_envs=3, overrides=["obs.signals=true"])
    rollout = env.rollout(4)
    terms = rollout["next", "terms"]
    assert set(terms.keys()) == {"jaw", "held"}
    paid = rollout["next", "reward"].sum(1)
    torch.testing.assert_close(paid, terms["jaw"][:, -1] + terms["held"][:, -1])
    dm = needlehoop.load(reward=lambda signals: signals.jaw, overrides=["obs.signals=true"])
    dm.reset()
    assert dm.step(torch.zeros(5).numpy()).reward > 0
    assert set(dm.task.moment.terms) == {"reward"}


def test_a_function_is_named_in_a_file_or_a_module(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def pay(signals, most=1.0):\n    return {'jaw': most * signals.jaw}\n")
    words = ["reward=python", f"reward.function={file}:pay", "+reward.values.most=3"]
    reward = load_reward(compose_settings(words).reward)
    signals = needlehoop.make_env(num_envs=2, overrides=["obs.signals=true"])
    signals.reset()
    seen = signals.simulation.look().signals
    assert torch.equal(reward(seen)["jaw"], 3 * seen.jaw)
    assert "def pay" in rewards.text(reward)
    words[1] = "reward.function=needlehoop.rewards.terms:potential"
    assert load_reward(compose_settings(words[:2]).reward).function is rewards.potential


def test_a_function_is_an_option_in_a_config_folder_of_one_s_own(tmp_path):
    values = {"defaults": ["python", "_self_"], "function": "test_own_parts:half", "name": "mine"}
    (tmp_path / "reward").mkdir()
    (tmp_path / "reward/mine.yaml").write_text(yaml.safe_dump({**values, "values": {"most": 7.0}}))
    settings = compose_settings([f"conf_dir={tmp_path}", "reward=mine"])
    reward = load_reward(settings.reward)
    assert reward.values == {"most": 7.0}
    assert "def half" in rewards.text(reward)
    assert reward_name(settings.reward) == "mine"
    with pytest.raises(ValueError, match=r"choose from .*file.*python"):
        compose_settings(["reward.kind=yours"])
