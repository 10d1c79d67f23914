"""The commands, as typed."""

import inspect
import os
import subprocess
import sys

import numpy as np
import pytest
import yaml
from PIL import Image

from needlehoop.cli.command import COMMANDS
from needlehoop.cli.main import main
from needlehoop.runs.shipped import CONF


def test_snapshot_writes_the_contact_sheet(tmp_path, capsys):
    out = tmp_path / "deep" / "sheet.png"
    assert main(["snapshot", "size=32", "raw=true", f"out={out}"]) == 0
    with Image.open(out) as sheet:
        pixels = np.asarray(sheet).astype(int)
    assert f"{pixels.shape[1]} x {pixels.shape[0]} px" in capsys.readouterr().out
    # Two blocks of three tiles in each of four rows.
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


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("levels.camera.shift=[0.001]", "levels.camera.shift: give amounts at severities 1 to 5"),
        ("+levels.camera.tilt=[0.001]", "levels.camera.tilt: no such axis"),
    ],
)
def test_levels_that_the_sheet_cannot_show_are_refused(word, message, tmp_path, capsys):
    words = ["disturbed=true", "cams=[rgb_front]", f"out={tmp_path}/sheet.png", word]
    assert main(["snapshot", *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("mine.png", ["snapshot", "out={}"]),
        ("mine.mp4", ["expert", "episodes=1", "--video", "{}"]),
    ],
)
def test_a_file_that_exists_is_not_replaced_unasked(name, arguments, tmp_path, capsys):
    file = tmp_path / name
    file.write_text("precious")
    assert main([word.format(file) for word in arguments]) == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert file.read_text() == "precious"


def test_tasks_lists_all_and_tells_a_named_ones_signals(capsys):
    assert main(["tasks"]) == 0
    output = capsys.readouterr().out
    assert "needle_hoop: " in output
    assert "  variants    reach, reach/near" in output
    assert "needle_tip" not in output
    assert main(["tasks", "task=wide"]) == 0
    output = capsys.readouterr().out
    assert "needle_tip" in output
    assert "reach: " not in output


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["expert", "controller=expart"], "controller: 'expart'"),
        (["expert", "episodes=1", "--video", "out.gif"], "--video: 'out.gif' must end in .mp4"),
        (["plot", "results/a", "cams=[]"], "'cams=[]' is not understood"),
        (["stress", "nobody", "out=a.csv"], "expert, smooth"),
        (["stress", "smooth", "out=a.csv", "severities=9"], "1 to 5"),
        (["stress", "smooth", "out=a.csv", "axes=[camera]"], "robot"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_key(arguments, text, capsys, elsewhere):
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith(f"needlehoop {arguments[0]}: ")
    assert text in error
    assert list(elsewhere.iterdir()) == []


def test_help_says_what_a_command_does_and_shows_its_keys(capsys):
    for name, command in COMMANDS.items():
        with pytest.raises(SystemExit) as stopped:
            main([*name.split(), "--help"])
        assert stopped.value.code == 0
        shown = capsys.readouterr().out
        assert inspect.getdoc(command.run).split()[0] in shown, name
        keys = yaml.safe_load((CONF / f"{command.config or 'env'}.yaml").read_text())
        # Those of every environment are only named.
        expected = {*keys} - {"defaults"} if command.config not in (None, "env") else ()
        assert [key for key in expected if f"\n{key}:" not in shown] == [], name


# imageio-ffmpeg leaves its pipes for the garbage collector to close.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("words", "columns"),
    [
        ([], ["weld", "friction"]),
        (
            ["episode.grasp=friction", "episode.max_steps=5", "video_episodes=1", "--video", "{}"],
            ["friction"],
        ),
    ],
)
def test_the_expert_grasps_as_it_is_told(capsys, tmp_path, words, columns):
    video = tmp_path / "expert.mp4"
    words = [word.format(video) for word in words]
    assert main(["expert", "episodes=2", "task=near", *words]) == 0
    _, heads, episodes, *_ = capsys.readouterr().out.splitlines()
    assert heads.split() == columns
    assert episodes.split() == ["episodes", *["2"] * len(columns)]
    assert video.exists() == ("--video" in words)


def test_a_reader_that_goes_ends_a_command_without_a_word():
    """As ``needlehoop tasks | head`` does."""
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "needlehoop.cli.main", "tasks"],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")
