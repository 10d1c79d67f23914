"""Episodes as datasets: what was done is what is read back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import imageio.v2 as imageio
import imageio_ffmpeg
import minari
import numpy as np
import pyarrow.parquet as pq
import pytest

from needlehoop.cli.main import main
from needlehoop.demonstrations.episodes import Demonstration, demonstrate, scripted
from needlehoop.demonstrations.lerobot_rows import proprio_names
from needlehoop.envs.settings import compose_settings
from needlehoop.tasks.registry import find

TASK = find("needle_hoop")

WORDS = ["cams=[dep_front,seg_side]", "image_size=32", "seed=5"]


@pytest.fixture(scope="module")
def shown() -> list[Demonstration]:
    return list(demonstrate(compose_settings(WORDS), scripted("smooth", TASK), 3))


@pytest.fixture(scope="module")
def minari_folder(tmp_path_factory) -> Path:
    """The folder of Minari's dataset smooth-v0."""
    out = tmp_path_factory.mktemp("minari")
    assert export(out / "smooth-v0") == 0
    return out


@pytest.fixture(scope="module")
def lerobot_folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("lerobot") / "smooth"
    assert export(out, "format=lerobot") == 0
    return out


def export(out: Path, *words: str) -> int:
    return main(["demonstrations", *WORDS, "episodes=3", f"out={out}", *words])


def test_demonstrations_are_whole_episodes(shown):
    for episode in shown:
        t = len(episode)
        assert episode.success
        assert episode.terminated
        assert episode.images["dep_front"].shape == (t + 1, 32, 32, 4)
        assert episode.images["seg_side"].shape == (t + 1, 32, 32, 3)
        assert episode.vectors["proprio"].shape == (t + 1, 8)
        assert episode.actions.shape == (t, 5)
        assert np.abs(episode.actions).max() <= 1
        # An episode's rewards add up to its last potential.
        assert 10.4 < episode.rewards.sum() < 12.2
        assert not np.array_equal(episode.images["seg_side"][0], episode.images["seg_side"][-1])


@pytest.mark.parametrize("name", ["smooth", "perturbed"])
def test_a_demonstration_does_not_depend_on_how_many_there_are(name):
    settings = replace(compose_settings(WORDS), cams=("seg_side",), image_size=8)
    (alone,) = demonstrate(settings, scripted(name, TASK), 1)
    first, _ = demonstrate(settings, scripted(name, TASK), 2)
    assert np.array_equal(alone.actions, first.actions)
    assert np.array_equal(alone.images["seg_side"], first.images["seg_side"])


@pytest.mark.parametrize("name", ["reach", "peg_transfer"])
def test_a_task_is_demonstrated_by_its_teacher_where_nobody_is_named(tmp_path, capsys, name):
    out, task = tmp_path / name, find(name)
    assert export(out, "format=lerobot", f"task={name}/standard", "image_size=16") == 0
    assert "3 episodes" in capsys.readouterr().out
    info = json.loads((out / "meta/info.json").read_text())
    assert info["needlehoop"]["demonstrator"] == task.teacher
    assert pq.read_table(out / "meta/tasks.parquet")["task"].to_pylist() == [task.summary]


def test_a_robot_of_ones_own_has_names_of_its_own():
    robot = replace(TASK.robot, body="gantry", proprio=("tool_midpoint", "jaw"))
    task = replace(TASK, robot=robot, controllers={"expert": None}, teacher="expert")
    assert proprio_names(task) == ["tool_midpoint_0", "tool_midpoint_1", "tool_midpoint_2", "jaw"]
    assert proprio_names(TASK)[-3:] == ["wrist_yaw", "jaw", "jaw_command"]
    with pytest.raises(ValueError, match=r"'smooth' is unknown; choose from expert, perturbed"):
        scripted("smooth", task)


def test_each_arms_actions_have_names(tmp_path):
    out = tmp_path / "two"
    words = ["task=handover", "cams=[seg_side]", "image_size=8", "episodes=1", "format=lerobot"]
    assert export(out, *words) == 0
    info = json.loads((out / "meta/info.json").read_text())
    action = info["features"]["action"]
    assert info["robot_type"] == "dvrk_psm"
    assert len(action["names"]) == action["shape"][0] == 10
    assert (action["names"][4], action["names"][-1]) == ("psm1_jaw", "psm2_jaw")


def test_minari_reads_what_was_done(minari_folder, monkeypatch, shown):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(minari_folder))
    dataset = minari.load_dataset("smooth-v0")
    assert dataset.total_episodes == 3
    assert dataset.total_steps == sum(map(len, shown))
    assert dataset.storage.metadata["algorithm_name"] == "smooth"
    for done, read in zip(shown, dataset.iterate_episodes(), strict=True):
        for name, rows in {**done.images, **done.vectors}.items():
            assert np.array_equal(read.observations[name], rows)
            assert dataset.observation_space[name].contains(rows[0])
        assert np.array_equal(read.actions, done.actions)
        assert np.array_equal(read.rewards, done.rewards)
        assert read.terminations.tolist() == [False] * (len(done) - 1) + [True]
        assert not read.truncations.any()
        assert read.infos["success"].tolist() == [False] * len(done) + [True]


def test_torchrl_reads_what_was_done(tmp_path, minari_folder, monkeypatch, shown):
    from tensordict import TensorDict
    from torchrl.data.datasets import MinariExperienceReplay

    # TorchRL 0.14.1 fills its tensors and then keeps empty ones of their shapes.
    monkeypatch.setattr(TensorDict, "memmap_like", TensorDict.memmap)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(minari_folder))
    replay = MinariExperienceReplay(
        "smooth-v0", batch_size=4, root=tmp_path / "torchrl", load_from_local_minari=True
    )
    assert len(replay) == sum(map(len, shown))
    steps = replay[:]
    actions = np.concatenate([episode.actions for episode in shown])
    assert np.array_equal(steps["action"].numpy(), actions)
    seen = np.concatenate([episode.images["dep_front"][1:] for episode in shown])
    assert np.array_equal(steps["next", "observation", "dep_front"].numpy(), seen)
    assert int(steps["next", "done"].sum()) == 3


def test_lerobot_layout_holds_what_was_done(lerobot_folder, shown):
    out = lerobot_folder
    info = json.loads((out / "meta/info.json").read_text())
    total = sum(map(len, shown))
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 25)
    assert (info["total_episodes"], info["total_frames"]) == (3, total)
    place = {"chunk_index": 0, "file_index": 0}
    table = pq.read_table(out / info["data_path"].format(**place))
    rows = table.to_pydict()
    columns = {name for name, feature in info["features"].items() if feature["dtype"] != "video"}
    assert set(rows) == columns
    means = json.loads((out / "meta/stats.json").read_text())
    actions = np.concatenate([f.actions for f in shown])
    assert means["action"]["mean"] == pytest.approx(actions.mean(0), abs=1e-6)
    assert means["action"]["q50"] == pytest.approx(np.median(actions, 0), abs=1e-6)
    assert np.array_equal(rows["action"], actions)
    state = np.concatenate([f.vectors["proprio"][:-1] for f in shown])
    assert np.array_equal(rows["observation.state"], state)
    assert sum(rows["next.success"]) == 3
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for episode, done in zip(episodes, shown, strict=True):
        frames = slice(episode["dataset_from_index"], episode["dataset_to_index"])
        assert rows["frame_index"][frames] == list(range(len(done)))
        assert set(rows["episode_index"][frames]) == {episode["episode_index"]}


def film_of(folder: Path, name: str) -> Path:
    return folder / f"videos/observation.images.{name}/chunk-000/file-000.mp4"


# imageio-ffmpeg leaves its pipes for the garbage collector to close.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_lerobot_films_show_what_was_seen(lerobot_folder, shown):
    expected = np.concatenate([episode.images["dep_front"][:-1, ..., :3] for episode in shown])
    with imageio.get_reader(film_of(lerobot_folder, "dep_front")) as film:
        frames = np.stack([np.asarray(frame) for frame in film])
        assert film.get_meta_data()["fps"] == 25
    assert frames.shape == expected.shape
    # Compressed, so not to the bit; but each frame is nearest to its own.
    apart = np.abs(frames.astype(int) - expected)
    assert apart.mean() < 3
    assert apart[40].mean() < np.abs(frames[40].astype(int) - expected[30]).mean()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("alone", [False, True], ids=["beside colour", "alone"])
def test_lerobot_depth_is_what_the_camera_gave(tmp_path, lerobot_folder, shown, alone):
    """Read as docs/demonstrations.md says: all of it from the metadata and the film."""
    out = lerobot_folder
    if alone:
        out = tmp_path / "alone"
        assert export(out, "format=lerobot", "renderings.dep.colour=none") == 0
    features = json.loads((out / "meta/info.json").read_text())["features"]
    colours = [name for name in features if name.startswith("observation.images.")]
    colours.remove("observation.images.dep_front_depth")
    seen = ["dep_front", "seg_side"][alone:]
    assert colours == [f"observation.images.{name}" for name in seen]

    feature = features["observation.images.dep_front_depth"]
    info = feature["info"]
    assert (feature["shape"], info["is_depth_map"], info["depth_unit"]) == ([32, 32, 1], True, "m")
    near, far = info["video.depth_min"], info["video.depth_max"]
    film = imageio_ffmpeg.read_frames(
        film_of(out, "dep_front_depth"), pix_fmt=info["video.pix_fmt"], bits_per_pixel=16
    )
    assert next(film)["fps"] == 25
    codes = np.stack([np.frombuffer(frame, "<u2").reshape(32, 32) for frame in film])
    depth = near + codes * (far - near) / 4095

    view = compose_settings(WORDS).views["front"]
    assert (near, far) == (view.near, view.far)
    nearness = np.concatenate([episode.images["dep_front"][:-1, ..., 3] for episode in shown]) / 255
    expected = view.far - nearness * (view.far - view.near)
    assert np.abs(depth - expected).max() <= (far - near) / 4095
    stats = json.loads((out / "meta/stats.json").read_text())["observation.images.dep_front_depth"]
    assert near <= stats["min"][0][0][0] < stats["mean"][0][0][0] < stats["max"][0][0][0] <= far


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_open_h_has_recoveries_first_and_then_failures(tmp_path):
    out = tmp_path / "open"
    words = ["cams=[rgb_wrist]", "demonstrator=perturbed", "episodes=4", "episode.max_steps=34"]
    assert export(out, "format=open_h", *words) == 0
    info = json.loads((out / "meta/info.json").read_text())
    lengths = [json.loads(x)["length"] for x in (out / "meta/episodes.jsonl").open()]
    stats = [json.loads(line)["stats"] for line in (out / "meta/episodes_stats.jsonl").open()]
    kinds = [name for name, span in info["splits"].items() for _ in range(*_ends(span))]
    assert set(kinds) == {"recovery", "failure"}
    assert kinds == sorted(kinds, reverse=True)
    frames = 0
    for number, (kind, length) in enumerate(zip(kinds, lengths, strict=True)):
        place = {"episode_chunk": 0, "episode_index": number}
        rows = pq.read_table(out / info["data_path"].format(**place)).to_pydict()
        film = out / info["video_path"].format(video_key="observation.images.rgb_wrist", **place)
        assert set(rows) == {k for k, item in info["features"].items() if item["dtype"] != "video"}
        assert rows["index"] == list(range(frames, frames + length))
        assert set(rows["episode_index"]) == {number}
        assert rows["next.success"][-1] == (kind == "recovery")
        assert set(rows["instruction.text"]) == {TASK.summary}
        assert set(rows["observation.meta.tool"]) == {"large_needle_driver"}
        assert stats[number]["action"]["mean"] == pytest.approx(np.mean(rows["action"], 0))
        with imageio.get_reader(film) as shown:
            assert sum(1 for _ in shown) == length
        frames += length
    assert info["total_frames"] == frames
    assert not (out / "waiting").exists()
    assert "TO FILL" in (out / "meta/README.md").read_text()


def _ends(span: str) -> tuple[int, int]:
    first, last = span.split(":")
    return int(first), int(last)


def test_what_cannot_be_is_said_in_a_line_and_leaves_nothing(tmp_path, tiny_run, capsys):
    for name, words, message in (
        (
            "smooth-v0",
            ["demonstrator=cheat"],
            "(or a run's folder): 'cheat' is unknown; choose from",
        ),
        ("smooth-v0", ["cams=[]"], "cams: demonstrations need at least one camera"),
        ("smooth", ["format=lerobot", "image_size=8"], "image_size: 8; LeRobot's films of depth"),
        ("smooth", ["format=open_h"], "cams: dep_front; format=open_h has no depth"),
        ("smooth", ["format=minari"], "such as smooth-v0"),
        ("smooth-v0", ["out=null"], "out: give a folder for the dataset, such as out=demos/"),
        (
            *("agent-v0", [f"demonstrator={tiny_run}"]),
            "cams: the agent's networks take what the run sees",
        ),
    ):
        assert export(tmp_path / name, *words) == 2
        assert message in capsys.readouterr().err.splitlines()[-1]
        assert not list(tmp_path.iterdir())
