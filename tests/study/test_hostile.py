"""A study among foreign files: each is named and left out, within a second, and nothing stops."""

from __future__ import annotations

import json
import os
import time
from itertools import product
from pathlib import Path

import pytest
from study_files import write_answers, write_run

from needlehoop.cli.main import main
from needlehoop.runs.reading import (
    TEXT,
    UnreadableError,
    printable,
    read_json,
    read_text,
    read_yaml,
)
from needlehoop.study.data.records import read_study
from needlehoop.study.render import figures

NAMES = ("config.yaml", "manifest.json", "reward.txt", "metrics.csv", "evaluations.csv")
NAMES += ("evaluation.json", "video.mp4")

BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(20)
)

CONTENTS = {
    "aliases": BOMB.encode(),
    "a value within itself": b"cams: &a [*a]\n",
    "deep YAML": b"cams: " + b"[" * 100_000,
    "deep JSON": b'{"a": ' * 100_000,
    "deep, and whole": b'{"a": ' * 500 + b"1" + b"}" * 500,
    "a long number": b'{"return": ' + b"9" * 100_000 + b"}",
    "a large number": b'{"return": 1e999, "episodes": ' + b"9" * 400 + b"}",
    "a long line": b"x" * 900_000,
    "boxes without end": b"\x00\x00\x00\x08free" * 100_000,
    "nothing": b"",
    "zeros": bytes(100_000),
    "half characters": b'{"return": "\\ud800"}',
}


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "main"
    for seed in (0, 1):
        write_run(folder, "rgb_default", seed=seed, updates=12, steps=122_880)
    write_answers(folder)
    return folder


@pytest.fixture
def run(study: Path) -> Path:
    return study / "rgb_default" / "human" / "seed1"


def hostile(path: Path, kind: str) -> None:
    """Put something in a file's place."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "3 GB":
        with path.open("wb") as file:
            file.truncate(3_000_000_000)
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(CONTENTS[kind])


def test_a_foreign_file_is_named_and_left_out_within_a_second(study, run):
    kinds = ("pipe", "device", "3 GB", "loop", "folder", *CONTENTS)
    for name, kind in product(NAMES, kinds):
        before = (run / name).read_bytes() if (run / name).exists() else None
        hostile(run / name, kind)
        began = time.process_time()
        found = read_study(study)
        assert time.process_time() - began < 1.0
        assert len(found.runs) == (1 if name == "config.yaml" else 2)
        # Any text will do as a reward's, and any keys as a manifest.
        if (name, kind) not in {
            *(("reward.txt", content) for content in CONTENTS if content != "nothing"),
            ("manifest.json", "half characters"),
        }:
            said = [str(one) for one in found.left_out]
            assert any(str((run / name).relative_to(study)) in one or name in one for one in said)
        (run / name).rmdir() if kind == "folder" else (run / name).unlink()
        if before is not None:
            (run / name).write_bytes(before)


@pytest.mark.parametrize("command", ["status", "report"])
def test_status_and_report_live_among_foreign_files(
    sketched, study, run, tmp_path, command, capsys
):
    kinds = ("aliases", "pipe", "deep JSON", "device", "a large number", "loop")
    for name, kind in zip(NAMES[1:], kinds, strict=True):
        hostile(run / name, kind)
    hostile(study / "vlm" / "questions.json", "pipe")
    hostile(study / "vlm" / "rankings.json", "deep, and whole")
    for kind in ("pipe", "deep JSON"):
        note = tmp_path / ".sweeps" / "x" / kind / "outcome.json"
        note.parent.mkdir(parents=True)
        hostile(note, kind)
    (study / "else\x1b[2Jwhere").symlink_to("/etc")
    assert main([command, str(study)]) == 0
    said = capsys.readouterr().out
    for name in NAMES[1:]:
        assert f"seed1/{name}: " in said
    assert r"else\x1b[2Jwhere: is a link to a folder" in said
    assert "\x1b" not in said


def test_a_link_out_of_the_study_is_not_in_the_report(sketched, study, run, tmp_path, capsys):
    secret = tmp_path / "secret"
    secret.write_text("the key to everything\n")
    (run / "reward.txt").unlink()
    (run / "reward.txt").symlink_to(secret)
    film = tmp_path / "private.mp4"
    film.write_bytes(b"\x00\x00\x00\x08moov")
    for seed in ("seed0", "seed1"):
        (run.parent / seed / "video.mp4").symlink_to(film)
    assert main(["report", str(study)]) == 0
    page = (study / "report.html").read_text()
    assert "the key to everything" not in page
    assert "data:video" not in page
    assert "private" not in page
    said = capsys.readouterr().out
    assert "seed1/reward.txt: is a link out of" in said
    assert "seed0/video.mp4: is a link out of" in said


def test_a_link_within_the_study_is_as_good_as_a_file(study, run):
    other = run.parent / "seed0" / "reward.txt"
    (run / "reward.txt").unlink()
    (run / "reward.txt").symlink_to(other)
    assert read_study(study).left_out == ()


def test_a_table_that_two_processes_wrote_is_not_counted(study, run, capsys):
    path = run / "metrics.csv"
    whole = path.read_text().splitlines()
    for spoil, said in (
        (lambda rows: rows[:5] + rows[3:], "updates that do not rise"),
        (lambda rows: [rows[0], *sorted(rows[1:] * 2)], "updates that do not rise"),
        (lambda rows: [rows[0], *rows[:0:-1]], "updates that do not rise"),
    ):
        path.write_text("\n".join(spoil(whole)) + "\n")
        found = read_study(study)
        assert found.runs[1].metrics is None
        assert any(said in str(one) for one in found.left_out)
    assert main(["status", str(study)]) == 0
    assert "more than one process wrote it" in capsys.readouterr().out


def test_a_former_run_is_not_counted(study, run):
    os.rename(run, run.with_name("seed1.1"))
    found = read_study(study)
    assert ([one.place.seed for one in found.runs], found.left_out) == ([0], ())


def test_no_reader_waits_or_fills_the_memory(tmp_path):
    for kind in ("pipe", "device", "3 GB", "loop", "folder"):
        hostile(tmp_path / kind, kind)
        for read in (read_text, read_json, read_yaml):
            with pytest.raises(UnreadableError, match=r"no plain file|larger than|can't be read"):
                read(tmp_path / kind)


def test_the_size_is_that_of_what_is_read(tmp_path):
    (tmp_path / "file").write_text("x" * TEXT)
    assert len(read_text(tmp_path / "file")) == TEXT
    (tmp_path / "file").write_text("x" * (TEXT + 1))
    with pytest.raises(UnreadableError, match="is larger than 1,000,000 bytes"):
        read_text(tmp_path / "file")
    # Says of itself that it is empty.
    assert "Linux" in read_text(Path("/proc/version"))
    with pytest.raises(UnreadableError, match="can't be read"):
        read_text(Path("a\0b"))


def test_json_is_what_json_says(tmp_path):
    (tmp_path / "file").write_text(json.dumps({"a": float("inf")}))
    with pytest.raises(UnreadableError, match="Infinity, which is no JSON"):
        read_json(tmp_path / "file")


def test_no_character_commands_the_terminal():
    assert printable("a\x1b[31mb\x07\r\n\tc\x9b\u202e\ud800é") == (
        "a\\x1b[31mb\\x07\\r\n\tc\\x9b\\u202e\\ud800é"
    )


def test_numbers_and_names_without_end_end_neither_plot_nor_report(study, tmp_path, capsys):
    """A run with returns of 1e308, and one whose camera's name is 60 characters of HTML."""
    huge = write_run(study, "dep_default", updates=12, steps=122_880)
    for name in ("metrics.csv", "evaluations.csv"):
        if (huge / name).exists():
            head, *lines = (huge / name).read_text().splitlines()
            at = head.split(",").index("return")
            rows = [line.split(",") for line in lines]
            for sign, row in enumerate(rows):
                row[at] = "-1e308" if sign % 2 else "1e308"
            (huge / name).write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    last = json.loads((huge / "evaluation.json").read_text())
    (huge / "evaluation.json").write_text(json.dumps({**last, "return": 1e308}))
    html = "<script>alert(document.cookie)</script>".ljust(60, "x").replace("/", "-")
    write_run(study, html, updates=12, steps=122_880)
    for command in ("report", "status"):
        out = [] if command == "status" else ["--out", str(tmp_path / "out")]
        assert main([command, str(study), *out]) == 0
        said = capsys.readouterr().out
        assert "dep_default/human/seed0/metrics.csv: has return that is not between" in said
        assert "dep_default/human/seed0/evaluation.json: has no usable return" in said
        assert "its config.yaml has no usable cams.0" in said
        assert "not drawn, V" not in said
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script>alert" not in page
    assert "rgb_default" in page


def test_a_figure_that_cannot_be_drawn_is_a_line(sketched, study, tmp_path, monkeypatch, capsys):
    def broken(findings):
        raise OverflowError("no axis is that long")

    monkeypatch.setitem(figures._DRAWN, "final_values", (broken, "Camera sets."))
    assert main(["plot", str(study), "--out", str(tmp_path)]) == 0
    assert "final_values: not drawn, OverflowError: no axis" in capsys.readouterr().out
    assert main(["report", str(study), "--out", str(tmp_path)]) == 0
    assert "final_values: not drawn, OverflowError" in (tmp_path / "report.html").read_text()


@pytest.mark.full
def test_long_names_leave_figures_room(tmp_path, capsys):
    """The longest names that a reward may have, and five cameras."""
    study = tmp_path / "main"
    cameras = "+".join(f"{'camera' * 6}_{i}" for i in range(5))
    for reward in ("human", "r" * 100):
        write_run(study, cameras, reward, updates=12, steps=122_880)
    assert main(["report", str(study)]) == 0
    said = capsys.readouterr().out
    page = (study / "report.html").read_text()
    assert "left out" not in said
    for name in ("final_values", "success_and_cheats", "rewards", "learning_curves"):
        assert f'id="figure_{name}"' in page
