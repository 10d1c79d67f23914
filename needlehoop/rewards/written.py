"""Rewards that are programs: a user's file, or what a vision-language model (VLM) wrote."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Real
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.program import Program, compile_program
from needlehoop.rewards.terms import potential
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.runs.shipped import RECORDINGS

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signal, Signals

FLAVOURS = {"vlm_text": "text", "vlm_img": "image"}
"""What a VLM was shown when it wrote a reward, by the reward's kind."""

KINDS = ("file", *FLAVOURS)
"""Kinds of rewards that are programs."""

ANY = "any"
"""The folder of programs that suit every camera set."""

FIRST = 1
"""The number of the sample that is used unless another is asked for."""

CLIPPED = "clipped"
"""The term that keeps a total within its limits."""

_EVERY = {"unit", "clip", "program"}
_RECORDED = _EVERY | {"cams", "results", "study", "recording", "sample"}
_KEYS = {"file": _EVERY | {"path"}, **dict.fromkeys(FLAVOURS, _RECORDED)}
"""The keys of a config, by its kind."""

_UNIT = re.compile(r"^unit = (?P<metres>[0-9.e-]+)$", re.MULTILINE)
"""The line of a program that gives the size of a scene unit in metres."""


class RewardError(RuntimeError):
    """A reward that is of no use at some state that training reached."""


@dataclass(frozen=True)
class Written:
    """A program in use. Its terms must be finite.

    Args:
        program: compiled.
        origin: where its text came from.
        clip: the least and the most that the total may be. The difference between the clipped
            total and the sum of the terms is a term of its own: ``clipped``, or ``clipped_1`` if
            the program has a term of that name.
    """

    program: Program
    origin: str
    clip: tuple[float, float] | None = None

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name.

        Raises:
            RewardError: a term is not finite. No number replaces it, because the agent would
                learn from that number.
        """
        terms = self.program(signals)
        for name, term in terms.items():
            finite = torch.isfinite(term)
            if not bool(finite.all()):
                bad = (~finite).nonzero().flatten().tolist()
                raise RewardError(
                    f"reward: term {name!r} of the program from {self.origin} is"
                    f" {float(term[bad[0]])} in environments {bad}; needlehoop vlm check"
                    " shows where a program is not finite"
                )
        if self.clip is None:
            return terms
        total = potential(terms)
        numbered = (f"{CLIPPED}_{number}" if number else CLIPPED for number in count())
        free = next(name for name in numbered if name not in terms)
        return {**terms, free: total.clamp(*self.clip) - total}

    def text(self) -> str:
        """For the record: the program's origin and its source."""
        confined = f", clipped to {self.clip[0]:g} to {self.clip[1]:g}" if self.clip else ""
        return f"# From {self.origin}{confined}.\n{self.program.source}"


@dataclass(frozen=True)
class Source:
    """A program's text and where it came from."""

    text: str
    origin: str


def load(config: Mapping[str, Any], table: Mapping[str, Signal]) -> Written:
    """The reward of a config whose ``kind`` is in ``KINDS``.

    Args:
        config: of the reward.
        table: of the task's signals, which a program may read.

    Raises:
        ValueError: missing or unknown values, no such program, or one that is refused.
    """
    source = scaled(_source(config), config["unit"], "reward.unit")
    clip = _limits(config["clip"])
    try:
        program = compile_program(source.text, table)
    except ProgramError as error:
        raise ValueError(f"reward: {source.origin}, {error}") from error
    return Written(program, source.origin, clip)


def pin(config: Mapping[str, Any]) -> dict[str, Any]:
    """A reward's config with the program's text in it. No file can change it afterwards.

    Raises:
        ValueError: as in ``load``.
    """
    if config.get("kind") not in KINDS:
        return dict(config)
    source = scaled(_source(config), config["unit"], "reward.unit")
    return {**config, "program": {"text": source.text, "origin": source.origin}}


def read(path: Path) -> Source:
    """The program in a file.

    Raises:
        ValueError: no plain file there, or one that is too large, empty or no text.
    """
    try:
        return Source(read_text(path), str(path))
    except UnreadableError as error:
        raise ValueError(f"reward.path: {str(path)!r} {error}") from error


def scaled(source: Source, unit: Any, key: str) -> Source:
    """A program with another size of its scene unit.

    Args:
        source: the program.
        unit: metres; ``None`` leaves the program as it is.
        key: of the unit, for messages.

    Raises:
        ValueError: no length, or the program has no line that gives its scene unit.
    """
    if unit is None:
        return source
    if isinstance(unit, bool) or not isinstance(unit, int | float) or not 0 < unit < float("inf"):
        raise ValueError(f"{key}: {unit!r} is not null or a positive number of metres")
    if len(_UNIT.findall(source.text)) != 1:
        raise ValueError(
            f"{key}: {source.origin} has no line such as unit = 0.05 to put {unit} into;"
            " leave it null"
        )
    return replace(source, text=_UNIT.sub(f"unit = {float(unit)!r}", source.text))


def find(
    cams: Iterable[str],
    flavour: str,
    study: str | None,
    results: str,
    recording: str | None,
    sample: int = FIRST,
) -> Source:
    """The program that was written for a camera set.

    First choice is the study's, ``<results>/<study>/vlm/rewards/<cameras>/<flavour>.txt``, then
    the recording's, ``needlehoop/recordings/<recording>/rewards/<cameras>/<flavour>.txt``. The
    cameras' order does not matter. A ``text`` program may also be in the folder ``any``.

    Args:
        cams: names of cameras.
        flavour: ``text`` or ``image``.
        study: its name; ``None`` searches the recording alone.
        results: folder of all studies.
        recording: the name of a shipped recording; ``None`` searches the study alone.
        sample: which of several programs for the same cameras.

    Raises:
        ValueError: an unknown flavour or recording, neither study nor recording, or no program.
            If a command can make the missing program, the message has it.
    """
    chosen = tuple(cams)
    folders = _folders(flavour, study, results, recording)
    name = file_name(flavour, _whole(sample))
    found = _search(folders, chosen, name)
    if found is None:
        known = sorted({file.parent.name for f in folders for file in f.glob(f"*/{name}")})
        which = "" if sample == FIRST else f" (sample {sample})"
        missing = (
            f"cams: no {flavour} reward{which} is recorded for {'+'.join(chosen) or 'no cameras'}"
            f" (there is {', '.join(known) or 'none'})"
        )
        if study is None:
            raise ValueError(f"{missing}; with reward.study=null only {recording} is looked into")
        how = command(chosen, flavour, study, results, sample)
        raise ValueError(f"{missing}; make one with: {how}")
    return found


def is_recorded(config: Mapping[str, Any]) -> bool:
    """Whether the program that a reward's config asks for exists.

    Raises:
        ValueError: as in ``find``. A missing program that a model could write is no error.
    """
    flavour = FLAVOURS.get(config["kind"])
    if flavour is None or config["program"] is not None:
        return True
    place, sample = _place(config), config["sample"]
    if place[0] is None:
        find(_cams(config), flavour, *place, sample)
    name = file_name(flavour, _whole(sample))
    return _search(_folders(flavour, *place), _cams(config), name) is not None


def file_name(flavour: str, sample: int = FIRST) -> str:
    """The name of a program's file: ``image.txt``, then ``image_2.txt``, …"""
    return f"{flavour}.txt" if sample == FIRST else f"{flavour}_{sample}.txt"


def check_flavour(flavour: str) -> None:
    """Raises ``ValueError`` for an unknown flavour."""
    if flavour not in FLAVOURS.values():
        valid = ", ".join(FLAVOURS.values())
        raise ValueError(f"flavour: {flavour!r} is unknown; choose from {valid}")


def command(
    cams: Iterable[str], flavour: str, study: str, results: str, sample: int = FIRST
) -> str:
    """The command that asks a VLM for a reward, into a study."""
    place = f"study={study}" + ("" if results == "results" else f" results={results}")
    place += "" if sample == FIRST else f" samples={sample}"
    return f"needlehoop vlm reward 'cams=[{','.join(cams)}]' flavour={flavour} {place} vlm=gemini"


def _folders(flavour: str, study: str | None, results: str, recording: str | None) -> list[Path]:
    check_flavour(flavour)
    if study is None and recording is None:
        raise ValueError("reward.study, reward.recording: both are null; give one to look into")
    folders = [] if study is None else [Path(results) / study / "vlm" / "rewards"]
    if recording is not None:
        shipped = sorted(f.name for f in RECORDINGS.glob("*") if f.is_dir())
        if recording not in shipped:
            valid = ", ".join(shipped)
            raise ValueError(f"recording: {recording!r} is unknown; choose from {valid}")
        folders.append(RECORDINGS / recording / "rewards")
    return folders


def _search(folders: Iterable[Path], cams: tuple[str, ...], name: str) -> Source | None:
    for folder in folders:
        for place in (_folder_of(folder, cams), folder / ANY if name.startswith("text") else None):
            file = None if place is None else place / name
            if file is not None and file.is_file():
                return read(file)
    return None


def _folder_of(folder: Path, cams: tuple[str, ...]) -> Path | None:
    """The folder of a camera set, in the given order or in another.

    Raises:
        ValueError: there are two in other orders.
    """
    exact = folder / "+".join(cams)
    if exact.is_dir() or not folder.is_dir():
        return exact
    same = [f for f in sorted(folder.iterdir()) if sorted(f.name.split("+")) == sorted(cams)]
    if len(same) > 1:
        raise ValueError(f"cams: {same[0]} and {same[1]} are the same cameras; remove one")
    return same[0] if same else None


def _whole(sample: Any) -> int:
    if isinstance(sample, bool) or not isinstance(sample, int) or sample < FIRST:
        raise ValueError(f"reward.sample: {sample!r} is not {FIRST} or a whole number above")
    return sample


def _limits(clip: Any) -> tuple[float, float] | None:
    if clip is None:
        return None
    try:
        low, high = strict.structure(clip, tuple[Real, Real], "reward.clip")
    except ValueError as error:
        raise ValueError(f"{error}; it is null or the least and the most, [0, 11]") from error
    if low >= high:
        raise ValueError(f"reward.clip: {low:g} must be below {high:g}")
    return low, high


def _source(config: Mapping[str, Any]) -> Source:
    """The pinned program, or the one that the config points at."""
    kind = config["kind"]
    if odd := (_KEYS[kind] | {"kind"}) ^ set(config):
        raise ValueError(
            f"reward: {', '.join(sorted(odd))} missing or unknown; {kind} takes"
            f" {', '.join(sorted(_KEYS[kind]))}"
        )
    pinned = config["program"]
    if pinned is not None:
        match pinned:
            case {"text": str(text), "origin": str(origin)} if len(pinned) == 2:
                return Source(text, origin)
        raise ValueError("reward.program: a run's own; it is null, or has a text and an origin")
    if kind == "file":
        path = strict.structure(config["path"], str, "reward.path")
        if not path:
            raise ValueError(f"reward.path: {path!r} is no name of a file")
        return read(Path(path))
    return find(_cams(config), FLAVOURS[kind], *_place(config), config["sample"])


def _cams(config: Mapping[str, Any]) -> tuple[str, ...]:
    return strict.structure(config["cams"], tuple[str, ...], "reward.cams")


def _place(config: Mapping[str, Any]) -> tuple[str | None, str, str | None]:
    """The study, the results' folder and the shipped recording to search."""
    study, recording = (
        strict.structure(config[key], str | None, f"reward.{key}") for key in ("study", "recording")
    )
    return study, strict.structure(config["results"], str, "reward.results"), recording
