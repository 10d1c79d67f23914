"""The commands, as typed."""

import inspect
import json
import os
import subprocess
import sys

import imageio.v2 as imageio
import numpy as np
import pytest
import yaml
from PIL import Image

from needlehoop.cli import look
from needlehoop.cli.command import COMMANDS
from needlehoop.cli.main import main
from needlehoop.runs.shipped import CONF


def test_snapshot_writes_the_contact_sheet(tmp_path, capsys):
    out = tmp_path / "deep" / "sheet.png"
    assert main(["snapshot", "size=32", "raw=true", f"out={out}"]) == 0
    with Image.open(out) as sheet:
        pixels = np.asarray(sheet).astype(int)
    assert f"{pixels.shape[1]} x {pixels.shape[0]} px" in capsys.readouterr().out
    # Two blocks of three tiles in each of four rows: start and goal differ in all rows.
    tile, gap, margin = 32, 2, 5
    block = 3 * (tile + gap) + margin // 2
    for row in range(4):
        y = 2 * margin + row * (tile + gap)
        strip = pixels[y : y + tile, margin:]
        start, goal = strip[:, : 3 * (tile + gap)], strip[:, block : block + 3 * (tile + gap)]
        assert start.std() > 10
        assert np.abs(start - goal).max() > 50


def test_snapshot_writes_what_each_camera_sees(tmp_path, capsys):
    out = tmp_path / "cameras"
    # Whoever has success end nothing reaches the goal all the same.
    words = ["image_size=32", "episode.end_on_success=false", f"out={out}"]
    assert main(["snapshot", "tiles=true", *words]) == 0
    assert len(list(out.iterdir())) == 12
    with Image.open(out / "seg_side.png") as tile:
        pixels = np.asarray(tile).astype(int)
    assert pixels.shape == (32, 64, 3)
    # The background is black, and the needle has moved.
    assert (pixels == 0).all(axis=-1).mean() > 0.5
    assert np.abs(pixels[:, :32] - pixels[:, 32:]).max() > 50
    assert main(["snapshot", "tiles=true", f"out={out}"]) == 2
    assert "exists" in capsys.readouterr().err
    assert main(["snapshot", "tiles=true", "out=cameras.png"]) == 2
    assert "tiles=true writes a folder" in capsys.readouterr().err


def test_picture_writes_a_still_and_replaces_a_file_when_asked(tmp_path):
    out = tmp_path / "still.png"
    out.write_text("old")
    words = ["picture", "size=40", f"out={out}", "picture.distance=1.2", "overwrite=true"]
    assert main(words) == 0
    with Image.open(out) as still:
        assert still.size == (40, 40)


def test_expert_prints_one_line_of_json(capsys):
    assert main(["expert", "--json", "episodes=4", "seed=2"]) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert len(lines) == 1
    found = json.loads(lines[0])
    for grasp in ("weld", "friction"):
        assert {"success", "cheat", "return"} <= set(found[grasp])
        assert found[grasp]["episodes"] == 4


# imageio-ffmpeg leaves its pipes for the garbage collector to close.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.full
def test_expert_writes_a_video(tmp_path, capsys):
    out = tmp_path / "expert.mp4"
    arguments = ["expert", "episodes=1", "grasps=[weld]", "video_episodes=1", "cams=[seg_side]"]
    arguments += ["episode.max_steps=40"]
    assert main([*arguments, "--video", str(out)]) == 0
    assert "success" in capsys.readouterr().out
    with imageio.get_reader(out) as video:
        # Not list(video): a reader of unknown length claims to be endless.
        frames = [frame for frame in video]  # noqa: C416
    assert len(frames) > 20
    assert frames[0].shape == (480, 640, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100
    assert [file.name for file in tmp_path.iterdir()] == ["expert.mp4"]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("mine.png", ["snapshot", "out={}"]),
        ("mine.png", ["picture", "out={}"]),
        ("mine.mp4", ["expert", "episodes=1", "--video", "{}"]),
    ],
)
def test_a_file_that_exists_is_not_replaced_unasked(name, arguments, tmp_path, capsys):
    mine = tmp_path / name
    mine.write_text("precious")
    assert main([word.format(mine) for word in arguments]) == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert mine.read_text() == "precious"


def test_signals_prints_the_table(capsys):
    assert main(["signals"]) == 0
    assert "needle_tip" in capsys.readouterr().out


@pytest.mark.full
def test_bench_measures_and_says_where_the_time_goes():
    # In a process of its own: the OpenGL library is chosen once in a process.
    arguments = ["bench", "--json", "num_envs=3", "rounds=1", "steps=2", "image_size=16"]
    command = [sys.executable, "-m", "needlehoop.cli.main", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert all(rate > 0 for rate in found["steps_per_second"].values())
    assert set(found["share_of_a_step"]) == {"physics", "images", "task_and_interface"}
    assert sum(found["share_of_a_step"].values()) == pytest.approx(1.0, abs=0.002)
    # Either the ratio was measured, or the report says why it could not be.
    assert (found["ratio_to_default_renderer"] is None) == bool(found["default_renderer_missing"])


LITTLE = ["rounds=1", "num_envs=4", "algo.horizon=8", "algo.minibatch=16"]
LITTLE += ["image_size=32", "steps=64"]


@pytest.mark.full
def test_bench_sb3_compares_the_two_under_the_same_algorithm():
    # The other side's share is kept small: it renders ten images a second.
    script = (
        "import sys; from needlehoop.cli import main as cli;"
        "from needlehoop.bench import stable_baselines as sb3;"
        "sb3.DM_CONTROL_ENVS, sb3.STEPS = 1, 4;"
        "sys.exit(cli.main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", script, "bench", "sb3", "--json", *LITTLE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        assert "no OpenGL" in done.stderr
        pytest.skip(done.stderr)
    found = json.loads(done.stdout)
    assert found["num_envs"] == {"needlehoop": 4, "dm_control": 1}
    rates = found["steps_per_second"]
    assert found["ratio"] == pytest.approx(rates["needlehoop"] / rates["dm_control"], rel=0.1)
    assert len(found["ratio_of_each_round"]) == 1


@pytest.mark.full
def test_bench_train_says_where_the_time_goes():
    # In a process of its own, into which no other test has brought Stable-Baselines3.
    script = (
        "import sys; from needlehoop.cli import main as cli; code = cli.main(sys.argv[1:]);"
        "sys.exit(code or 'stable_baselines3' in sys.modules)"
    )
    words = ["bench", "train", "--json", *LITTLE, "engine.threads=2", "against=disturb=mild"]
    command = [sys.executable, "-c", script, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["threads"] == 2
    rate, other = found["steps_per_second"], found["steps_per_second_against"]
    assert min(rate, other) > 0
    assert found["ratio"] == pytest.approx(rate / other, rel=0.1)
    assert 0 < found["share_learning"] < 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["expert", "controller=expart"], "controller: 'expart'"),
        (["expert", "episodes=0"], "episodes: 0"),
        (["expert", "grasps=[glue]"], "grasps: 'glue' is unknown; choose from weld"),
        (["expert", "episodes=1", "--video", "out.gif"], "--video: 'out.gif' must end in .mp4"),
        (["expert", "task=hard"], "handover near peg_transfer reach standard wide"),
        (["export", "what=hand"], "what: 'hand' is unknown; choose from arm, scene"),
        (["snapshot", "out=sheet.bmp"], "out: 'sheet.bmp' must end in .png"),
        (["bench", "cams=[]"], "cams"),
        (["bench", "rounds=0"], "rounds: 0"),
        (["bench", "everything"], "what: 'everything' is unknown; choose from speed, train"),
        (["bench", "train", "against=disturb=mid"], "mild moderate none severe"),
        (["bench", "against=disturb=mild"], "against: bench speed compares nothing"),
        (["bench", "train", "cams=[]"], "cams"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_key(arguments, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(f"needlehoop {arguments[0]}: ")
    assert said in error
    assert list(tmp_path.iterdir()) == []


def test_view_without_a_display_says_so(capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view"]) == 2
    assert "no display" in capsys.readouterr().err


def test_help_says_what_a_command_does_and_shows_its_keys(capsys):
    for name, command in COMMANDS.items():
        with pytest.raises(SystemExit) as stopped:
            main([*name.split(), "--help"])
        assert stopped.value.code == 0
        shown = capsys.readouterr().out
        assert inspect.getdoc(command.run).split()[0] in shown, name
        keys = yaml.safe_load((CONF / f"{command.config or 'env'}.yaml").read_text())
        # Those of every environment are only named.
        own = {*keys} - {"defaults"} if command.config not in (None, "env") else ()
        assert [key for key in own if f"\n{key}:" not in shown] == [], name


def test_an_unknown_option_is_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["expert", "--jsn"])
    assert stopped.value.code == 2
    assert "--jsn" in capsys.readouterr().err


def test_a_reader_that_goes_ends_a_command_without_a_word():
    """As ``needlehoop signals | head`` does."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "needlehoop.cli.main", "signals"],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


def test_another_pipe_that_breaks_is_an_error(monkeypatch, capfd):
    def broken(*_):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(look, "environment", broken)
    assert main(["signals"]) == 2
    assert "Broken pipe" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "columns"),
    [([], ["weld", "friction"]), (["episode.grasp=friction"], ["friction"])],
)
def test_the_expert_grasps_as_it_is_told(capsys, words, columns):
    assert main(["expert", "episodes=2", "task=near", *words]) == 0
    _, heads, episodes, *_ = capsys.readouterr().out.splitlines()
    assert heads.split() == columns
    assert episodes.split() == ["episodes", *["2"] * len(columns)]


def test_the_expert_is_told_its_grasp_once(capsys):
    assert main(["expert", "grasps=[weld]", "episode.grasp=friction"]) == 2
    assert "grasps: episode.grasp=friction names one already" in capsys.readouterr().err
