"""Rewards that are loaded from programs."""

from __future__ import annotations

import pytest
import torch
from needle_task import load_reward, random_signals

import needlehoop
from needlehoop import rewards
from needlehoop.config import composing
from needlehoop.envs.settings import compose_settings
from needlehoop.rewards import program_reward


@pytest.fixture
def place(elsewhere, monkeypatch):
    """An empty folder to work in, with recordings of its own; writes programs."""
    monkeypatch.setattr(program_reward, "RECORDINGS", elsewhere / "recordings")
    (elsewhere / "recordings" / "paper").mkdir(parents=True)

    def write(where: str, value: float = 1) -> None:
        folder = "recordings/paper" if where.startswith("rewards/") else "results"
        file = elsewhere / folder / where
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"a = {value}\nb = 2\nreward = a + b\n")

    return write


def worth(reward: rewards.Reward) -> float:
    return float(rewards.potential(reward(random_signals(1, seed=0)))[0])


def loaded(*words: str, name: str = "env") -> rewards.Reward:
    return load_reward(composing.compose(words, name)["reward"])


def test_a_file_is_loaded(place, tmp_path):
    (tmp_path / "mine.txt").write_text("reward = 4.5")
    assert worth(loaded("reward=file", "reward.path=mine.txt")) == 4.5
    env = needlehoop.make_env(reward="file", num_envs=2, overrides=["reward.path=mine.txt"])
    assert env.reset()["terms", "reward"].flatten().tolist() == [4.5, 4.5]


def test_a_set_of_cameras_has_a_program_in_any_order(place):
    place("rewards/dep_front+seg_side/image.txt", 3)
    place("rewards/dep_front/image.txt", 4)
    place("rewards/dep_front/image_2.txt", 5)
    assert worth(loaded("reward=vlm_img", "cams=[seg_side,dep_front]")) == 5
    assert worth(loaded("reward=vlm_img", "cams=[dep_front]")) == 6
    assert worth(loaded("reward=vlm_img", "cams=[dep_front]", "reward.sample=2")) == 7


def test_the_studys_program_comes_before_the_recordings(place):
    place("rewards/dep_front/image.txt", 3)
    place("mine/vlm/rewards/dep_front/image.txt", 4)
    words = ["reward=vlm_img", "cams=[dep_front]"]
    assert worth(loaded(*words, "study=mine", name="job")) == 6
    assert worth(loaded(*words, name="job")) == 5
    assert worth(loaded(*words, "reward.study=mine")) == 6


def test_a_recording_alone_is_looked_into_where_no_study_is_named(place):
    place("rewards/dep_front/image.txt", 3)
    place("main/vlm/rewards/dep_front/image.txt", 4)
    place("main/vlm/rewards/seg_side/image.txt", 4)
    alone = ["reward=vlm_img", "reward.study=null"]
    assert worth(loaded(*alone, "cams=[dep_front]")) == 5
    message = (
        r"no image reward is recorded for seg_side \(there is dep_front\); .*no model can write one"
    )
    values = composing.compose([*alone, "cams=[seg_side]"])["reward"]
    # Not one to ask a model for either: what it wrote would not be found.
    for refusing in (load_reward, program_reward.is_recorded):
        with pytest.raises(ValueError, match=message):
            refusing(values)


def test_a_text_program_serves_any_cameras_unless_they_have_their_own(place):
    place("rewards/any/text.txt", 3)
    place("rewards/dep_front/text.txt", 4)
    place("rewards/any/image.txt", 5)
    assert worth(loaded("reward=vlm_text", "cams=[rgb_side]")) == 5
    assert worth(loaded("reward=vlm_text", "cams=[dep_front]")) == 6


def test_a_missing_program_names_the_command_that_makes_it(place):
    place("rewards/dep_front+seg_side/image.txt")
    with pytest.raises(
        ValueError, match=r"no image reward .*there is dep_front\+seg_side"
    ) as caught:
        compose_settings(["reward=vlm_img", "cams=[rgb_front,seg_side]"])
    command = "vlm reward 'cams=[rgb_front,seg_side]' flavour=image study=main vlm=gemini"
    assert f"needlehoop {command}" in str(caught.value)


def test_a_bad_file_or_value_is_refused_by_name(place, tmp_path):
    file = tmp_path / "mine.txt"
    for text, words, message in (
        (b"reward = gaol", [], "mine.txt, line 1, column 10: 'gaol' is unknown"),
        (b"reward = 1", ["reward.path=none.txt"], "reward.path: none.txt can't be read: No such"),
        (b"reward = 1", ["reward.clip=[3,1]"], "reward.clip: 3 must be below 1"),
        (b"reward = 1", ["+reward.bonus=1"], "unknown key bonus; its keys are"),
        (b"reward = 9", ["reward.unit=0.1"], "reward.unit: mine.txt has no line such as unit"),
    ):
        file.write_bytes(text)
        with pytest.raises(ValueError, match=message):
            loaded("reward=file", "reward.path=mine.txt", *words)


def test_clipping_is_a_term_of_its_own(place, tmp_path):
    (tmp_path / "mine.txt").write_text("a = 20 * jaw\nb = 1\nreward = a + b")
    words = ["reward=file", "reward.path=mine.txt"]
    signals = random_signals(200, seed=0)
    plain, clip = (loaded(*words, *more)(signals) for more in ([], ["reward.clip=[0,11]"]))
    assert list(plain) == ["a", "b"]
    assert list(clip) == ["a", "b", "clipped"]
    before = rewards.potential(plain)
    assert float(before.min()) < 0
    assert float(before.max()) > 11
    torch.testing.assert_close(rewards.potential(clip), before.clamp(0, 11), rtol=0, atol=1e-12)


def test_a_term_that_is_not_finite_stops_the_environment(place, tmp_path):
    (tmp_path / "mine.txt").write_text("good = 1\nbad = 1 / elapsed\nreward = good + bad")
    with pytest.raises(rewards.RewardError, match=r"term 'bad' of the program from mine\.txt"):
        needlehoop.make_env(reward="file", num_envs=2, overrides=["reward.path=mine.txt"])


def test_a_program_in_scene_units_takes_another_size_of_them(tmp_path):
    file = tmp_path / "mine.txt"
    file.write_text("unit = 0.05\nreward = 9 / unit")
    assert worth(loaded("reward=file", f"reward.path={file}")) == pytest.approx(180)
    config = composing.compose(["reward=file", f"reward.path={file}", "reward.unit=0.1"])["reward"]
    assert worth(load_reward(config)) == pytest.approx(90)
    # A pinned program does not change with its file. It is what the run is paid by.
    pinned = rewards.with_source(config)
    file.unlink()
    assert rewards.text(load_reward(pinned)) == f"# From {file}.\nunit = 0.1\nreward = 9 / unit"
    assert rewards.with_source(pinned) == pinned
    assert config["program"] is None
