"""Whatever is typed for whatever key: a sane run, or one line that names the key, and no litter.

``FUZZ_CASES`` says how many of all pairs of keys and values are tried (``strength.py``). Their
number decides which, so that a failure can be had again.
"""

from __future__ import annotations

import csv
import math
import random
import shutil
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from strength import FUZZ_CASES
from tiny_runs import TINY, refusal, run_train

from needlehoop.cli import train as command_line
from needlehoop.cli.main import main
from needlehoop.config import composing, options
from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.job import Job
from needlehoop.runs.shipped import CONF, RECORDINGS
from needlehoop.training import loop as train

GROUPS = {folder.name for folder in CONF.iterdir() if folder.is_dir()} | {"cams"}

REAL = FUZZ_CASES // 25
"""Of the runs that are accepted, those that are trained to their end."""

VALUES = (
    *("null", "true", "false", "no", "off", "yes", "'false'", "nope", "''"),
    *("0", "1", "2", "3", "5", "10", "-1", "-2", "1e9", "1e308", "-1e308"),
    *("0.5", "-0.5", "1.0", "1e-9", "0.01", "0.3"),
    *("nan", "inf", "-inf", "1e400", str(2**63 - 1), str(2**63), str(2**64), "9" * 400),
    *("[]", "[a]", "[1,2]", "[1,2,3]", "[nan,0,0]", "[0,0,inf]", "[null]", "[[1],[2]]", "[true]"),
    *("{}", "{a: 1}", "{a: {b: nan}}", "{kind: nope}"),
    *("'ü漢'", "'a b'", "' a'", "'../../x'", "'/'", "'.'", "'a/b'", "'~'", "'a\\tb'", "'a\\x1bb'"),
    *("'" + "x" * 300 + "'", "'" + "x" * 5000 + "'", "'a=b'", "'${seed}'", "1_000", "0x10", "1:30"),
)

COMMANDS = {
    "snapshot": ("snapshot", []),
    "expert": ("expert", []),
    "probe": ("probe", []),
    "check": ("vlm check", ["cams=[dep_front,seg_side]"]),
    "demonstrations": ("demonstrations", ["out=smooth-v0"]),
    "stress": ("stress smooth", ["out=stress.csv"]),
    "vlm_question": ("vlm question", []),
    "vlm_rank": ("vlm rank", []),
    "vlm_reward": ("vlm reward", ["cams=[dep_front,seg_side]"]),
}
"""By the name of their config: the words of a command, and what it needs."""

HEAVY = (
    "needlehoop.pictures.stills.contact_sheet",
    "needlehoop.envs.controllers.run_trials",
    "needlehoop.probe.measuring.probe",
    "needlehoop.learning.stress.stress",
    "needlehoop.runs.files.new_folder",
    "needlehoop.vlm.inquiry.Inquiry",
    "needlehoop.vlm.card.card",
)
"""What commands do once they have understood what is asked."""


PROGRAM = RECORDINGS / "paper" / "rewards" / "any" / "text.txt"
FUNCTION = f"{Path(__file__).parents[1]}/examples/own_reward.py:reward"

NEEDED = {
    "reward=file": [f"reward.path={PROGRAM}"],
    "reward=python": [f"reward.function={FUNCTION}"],
    "reward=vlm_img": ["cams=[dep_front,seg_side]"],
    "reward=vlm_text": ["cams=[dep_front,seg_side]"],
    "reward=vlm_img_claude": ["cams=[dep_front,seg_side]"],
    "reward=vlm_text_claude": ["cams=[dep_front,seg_side]"],
    **{f"vlm={name}": ["vlm.model=m"] for name in ("gemini", "openai", "manual")},
}
"""What an option of a group can't be chosen without."""


class Understood(BaseException):
    """A command was about to begin its work."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    composing.prepare([])
    # Registering anew for each case would take longer than the case.
    monkeypatch.setattr(options, "register_cameras", lambda *_: None)
    return tmp_path


def keys_of(name: str, words: list[str]) -> list[str]:
    """All keys of a config, its groups too, but for those of Hydra and of cameras."""

    def flat(values: Mapping[str, Any], above: str = "") -> Iterator[str]:
        for key, value in values.items():
            yield f"{above}{key}"
            if isinstance(value, Mapping):
                yield from flat(value, f"{above}{key}.")

    return [key for key in flat(composing.compose(words, name)) if key.split(".")[0] != "cams"]


def cases(name: str, words: list[str], count: int) -> list[tuple[str, str]]:
    every = [(key, value) for key in keys_of(name, words) for value in VALUES]
    return random.Random(count).sample(every, min(count, len(every)))


def cases_of_groups(count: int) -> list[tuple[list[str], str, str]]:
    """Of all options of all groups of a training: what to choose, a key of it, a value."""
    groups = GROUPS & {*composing.compose(TINY, "config")}
    choices = [
        f"{group}={file.stem}" for group in sorted(groups) for file in (CONF / group).glob("*.yaml")
    ]
    every = []
    # Each choice is composed for its keys, which takes longer than a case.
    for choice in random.Random(count).sample(choices, min(count // 3, len(choices))):
        # Passes over a buffer are reinforcement's alone.
        tiny = [word for word in TINY if choice != "algo=dagger" or "algo.epochs" not in word]
        words, group = [*tiny, *NEEDED.get(choice, []), choice], choice.partition("=")[0]
        own = [key for key in keys_of("config", words) if key.startswith(f"{group}.")]
        every += [(words, key, value) for key in own for value in VALUES]
    return random.Random(count).sample(every, min(count, len(every)))


def check_refusal(said: str, key: str, word: str) -> None:
    assert said.count("\n") <= 1, (word, said)
    assert said.strip(), word
    assert "Traceback" not in said, (word, said)
    assert said.strip().isprintable(), (word, said)
    assert len(said) < 2000, (word, said)
    parts = {key, key.rpartition(".")[2], key.partition(".")[0], "grammar", "interpolation"}
    assert any(part in said for part in parts), (word, said)


def clear(place: Path) -> None:
    for path in place.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def is_small(job: Job) -> bool:
    """Whether a run takes a second or so."""
    passes = job.algo.epochs if isinstance(job.algo, PpoConfig) else job.algo.minibatches
    work = (job.steps, 200), (job.env.num_envs, 8), (job.algo.horizon, 16), (passes, 4)
    size = (job.algo.network.hidden, 64), (job.algo.network.layers, 3), (job.env.image_size, 64)
    episode = (job.env.episode.substeps, 20), (job.env.episode.max_steps, 20)
    own = job.evaluation
    ends = (own.episodes, 3), (own.final_episodes, 3), (own.video_episodes, 0)
    return not job.env.cams and all(
        value <= most for value, most in (*work, *size, *episode, *ends)
    )


def is_sane(folder: Path) -> bool:
    with (folder / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    losses = [float(row[name]) for row in rows for name in row if name.startswith("loss_")]
    return bool(losses) and all(map(math.isfinite, losses))


def drive(words: list[str]) -> tuple[str | None, float]:
    """``train.py`` below Hydra: what it refuses with, and the seconds of this process."""
    began = time.process_time()
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            values = composing.compose(words, "config")
            command_line.begin(values, words, "python train.py")
    except command_line.KNOWN as error:
        return command_line.in_a_line(error), time.process_time() - began
    return None, time.process_time() - began


def test_any_value_for_any_key_of_a_training(place, monkeypatch):
    real, trained = train.train, Counter()

    def some(job: Job, run: Any, *rest: Any) -> str:
        trained["accepted"] += 1
        if not is_small(job) or trained["real"] >= REAL:
            run.unmake()
            return "stopped"
        trained["real"] += 1
        end = real(job, run, *rest)
        assert end in ("done", "paused")
        assert is_sane(run.folder), job
        return end

    monkeypatch.setattr(train, "train", some)
    refused, wrong = 0, []
    own = [(TINY, *case) for case in cases("config", TINY, FUZZ_CASES * 2 // 5)]
    for words, key, value in own + cases_of_groups(FUZZ_CASES // 5):
        word = f"{key}={value}"
        try:
            said, seconds = drive([*words, word])
            if said is not None:
                refused += 1
                check_refusal(said, key, word)
                assert seconds < 2.0, word
                assert list(place.iterdir()) == [], word
        # Whatever it is, and then the next: one look tells of all.
        except Exception as error:
            wrong.append((*words[len(TINY) :], word, repr(error)[:500]))
        clear(place)
    assert not wrong
    assert refused > FUZZ_CASES // 5
    assert trained["real"] > REAL // 2


@pytest.mark.parametrize("name", COMMANDS)
def test_any_value_for_any_key_of_a_command(place, monkeypatch, name):
    def understood(*_: Any, **__: Any) -> None:
        raise Understood

    for path in HEAVY:
        monkeypatch.setattr(path, understood)
    command, needed = COMMANDS[name]
    for key, value in cases(name, needed, FUZZ_CASES * 2 // 5 // len(COMMANDS) + 1):
        word = f"{key}={value}"
        out, err = StringIO(), StringIO()
        began = time.process_time()
        try:
            with redirect_stdout(out), redirect_stderr(err):
                status = main([*command.split(), *needed, word])
        except Understood:
            status = None
        if status is not None:
            # ``vlm check`` has said no, with its reason; anything else is an error.
            assert status in (1, 2), word
            check_refusal(err.getvalue() if status == 2 else out.getvalue(), key, word)
            assert time.process_time() - began < 2.0, word
            assert list(place.iterdir()) == [], word
        clear(place)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("overwrite='false'", "overwrite: 'false' is not true or false"),
        ("existing=null", "existing: None is not a text"),
        ("task=5", "task: 5 is no option; choose from near, peg_transfer, reach, standard, wide"),
        ("cams=null", "cams: None is no list of cameras"),
        ("study=[a", "study"),
        ("init=nowhere", "init: nowhere is no run"),
        ("resume=''", "resume: give the folder of a run"),
        ("resume=/nowhere/a=b/{c}", "/nowhere/a=b/{c} is no run"),
    ],
)
def test_the_whole_command_refuses_in_a_line(tmp_path, monkeypatch, capfd, word, said):
    """With Hydra around it, which the others leave out."""
    monkeypatch.chdir(tmp_path)
    words = [word] if word.startswith("resume=/") else [*TINY, word]
    assert said in refusal(*words)
    assert capfd.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("-m seed=0,nan", "seed: nan is not a whole number"),
        ("-m seed=0,1000001", "evaluation.seed"),
        ("-m seed=0,1 results=null", "results: None is not a text"),
        ("-m task=nope,wide", "task/nope"),
        ("-m seed=0,1 algo.gamma=nan", "algo.gamma: nan is not finite"),
        ("-m seed=[0,1", "[0,1"),
        ("-m seed=0 steps=24,1", "steps: 1 is less than one buffer"),
        ("+experiment=nope", "experiment/nope"),
        ("+experiment=table2 seed=-1", "seed: -1 is negative"),
    ],
)
def test_a_sweep_with_a_mistake_starts_nothing(tmp_path, monkeypatch, words, said, capfd):
    monkeypatch.chdir(tmp_path)
    tiny = [word for word in TINY if "+experiment" not in words or "reward" not in word]
    told = refusal(*tiny, *words.split())
    assert said in told
    assert "Traceback" not in told + capfd.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_into_a_folder_that_nobody_may_write_says_so(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert "file" in refusal("-m", *TINY, "seed=0", "results=file/results")
    assert "Traceback" not in capfd.readouterr().err


def test_what_is_typed_for_resume_is_a_path():
    for path in ("a=b", "a{b}", "it's", "a b", "a,b", "[a]", "a\\", "a\\'b", "${x}", "ü", "a'"):
        word = composing.quoted(f"resume={path}")
        (parsed,) = OverridesParser.create().parse_overrides([word])
        assert parsed.value() == path, word
    assert composing.quoted("resume=null") == "resume=null"
    assert composing.quoted("seed=3") == "seed=3"


def test_a_run_of_a_path_with_odd_characters_goes_on(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_train(*TINY, "results='a=b {c}'")
    assert "is finished" in refusal("resume=a=b {c}/main/signals/sparse/seed0")


def test_every_value_is_parsed_by_hydra():
    for value in VALUES:
        (parsed,) = OverridesParser.create().parse_overrides([f"key={value}"])
        OmegaConf.create({"key": parsed.value()})
