"""Rewards that are loaded from programs: a user's file, or one that a VLM wrote."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import count, islice
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
    from needlehoop.scene.signals import Signals

FLAVOURS = {"vlm_text": "text", "vlm_img": "image"}
"""What a VLM was shown when it wrote a reward, by the reward's kind."""

KINDS = ("file", *FLAVOURS)
"""Kinds of rewards that are programs."""

ANY = "any"
"""The folder of programs that suit every set of cameras."""

FIRST = 1
"""The sample that a reward is, unless another is asked for."""

_KEYS = {
    "file": {"path", "unit", "clip", "program"},
    "vlm_text": {"cams", "results", "study", "recording", "sample", "unit", "clip", "program"},
    "vlm_img": {"cams", "results", "study", "recording", "sample", "unit", "clip", "program"},
}


_UNIT = re.compile(r"^unit = (?P<metres>[0-9.e-]+)$", re.MULTILINE)
"""How a program says how many metres a scene unit has."""

CLIPPED = "clipped"
"""The term by which a total is kept within its limits."""


class RewardError(RuntimeError):
    """A reward that is of no use at some state that training reached."""


@dataclass(frozen=True)
class Written:
    """A program in use: its terms, which must be finite.

    Args:
        program: what it computes.
        origin: where the program came from.
        clip: the least and the most that the total may be; what it is changed by to keep to
            that is the term ``clipped`` (``clipped_1`` where the program has one of that name).
    """

    program: Program
    origin: str
    clip: tuple[float, float] | None = None

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name.

        Raises:
            RewardError: a term is not finite. Nothing is put in its place: a number made up
                here would be learnt from.
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
        return {**terms, _free(CLIPPED, terms): total.clamp(*self.clip) - total}

    def text(self) -> str:
        """For the record: where the program came from, and its source."""
        confined = f", clipped to {self.clip[0]:g} to {self.clip[1]:g}" if self.clip else ""
        return f"# From {self.origin}{confined}.\n{self.program.source}"


@dataclass(frozen=True)
class Source:
    """A program's text and where it came from."""

    text: str
    origin: str


def _free(name: str, taken: Mapping[str, Any]) -> str:
    """A name that is not taken: this one, or with a number."""
    numbered = (f"{name}_{number}" for number in count(1))
    return next(one for one in (name, *islice(numbered, len(taken))) if one not in taken)


def file_name(flavour: str, sample: int = FIRST) -> str:
    """What a program's file is called: ``image.txt``; of further samples ``image_2.txt``, …"""
    return f"{flavour}.txt" if sample == FIRST else f"{flavour}_{sample}.txt"


def find(
    cams: Iterable[str],
    flavour: str,
    study: str | None,
    results: str,
    recording: str | None,
    sample: int = FIRST,
) -> Source:
    """The program that was written for a set of cameras.

    It is the study's, ``<results>/<study>/vlm/rewards/<cameras>/<flavour>.txt``, or else the
    recording's, ``needlehoop/recordings/<recording>/rewards/<cameras>/<flavour>.txt``. The
    cameras' order does not matter; ``text`` may also stand in the folder ``any``.

    Args:
        cams: names of cameras.
        flavour: ``text`` or ``image``.
        study: whose folder comes first; ``None``: the recording alone.
        results: folder of all studies.
        recording: the name of a shipped recording; ``None``: the study's folder alone.
        sample: which of several programs for the same cameras.

    Raises:
        ValueError: a flavour or recording that is unknown, neither study nor recording, or no
            program; the message has the command that makes one, if that is of use.
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
    """Whether there is the program that a reward's config asks for.

    Raises:
        ValueError: as in ``find``, but for a missing program that can be made.
    """
    flavour = FLAVOURS.get(config["kind"])
    if flavour is None or config["program"] is not None:
        return True
    place, sample = _place(config), config["sample"]
    if place[0] is None:
        find(_cams(config), flavour, *place, sample)
    name = file_name(flavour, _whole(sample))
    return _search(_folders(flavour, *place), _cams(config), name) is not None


def check_flavour(flavour: str) -> None:
    """Raises ``ValueError`` for a flavour that there is not."""
    if flavour not in FLAVOURS.values():
        valid = ", ".join(FLAVOURS.values())
        raise ValueError(f"flavour: {flavour!r} is unknown; choose from {valid}")


def _folders(flavour: str, study: str | None, results: str, recording: str | None) -> list[Path]:
    check_flavour(flavour)
    if study is None and recording is None:
        raise ValueError("reward.study, reward.recording: both are null; give one to look into")
    own = [] if study is None else [Path(results) / study / "vlm" / "rewards"]
    return own if recording is None else [*own, _recording(recording) / "rewards"]


def _search(folders: Iterable[Path], cams: tuple[str, ...], name: str) -> Source | None:
    for folder in folders:
        for place in (_folder_of(folder, cams), folder / ANY if name.startswith("text") else None):
            file = None if place is None else place / name
            if file is not None and file.is_file():
                return read(file)
    return None


def _whole(sample: Any) -> int:
    if isinstance(sample, bool) or not isinstance(sample, int) or sample < FIRST:
        raise ValueError(f"reward.sample: {sample!r} is not {FIRST} or a whole number above")
    return sample


def command(
    cams: Iterable[str], flavour: str, study: str, results: str, sample: int = FIRST
) -> str:
    """The command that asks a VLM for a reward, into a study."""
    place = f"study={study}" + ("" if results == "results" else f" results={results}")
    place += "" if sample == FIRST else f" samples={sample}"
    return f"needlehoop vlm reward 'cams=[{','.join(cams)}]' flavour={flavour} {place} vlm=gemini"


def _folder_of(folder: Path, cams: tuple[str, ...]) -> Path | None:
    """The folder of a set of cameras, by its name or by that of another order.

    Raises:
        ValueError: two other orders, and no way to tell which.
    """
    exact = folder / "+".join(cams)
    if exact.is_dir() or not folder.is_dir():
        return exact
    same = [f for f in sorted(folder.iterdir()) if sorted(f.name.split("+")) == sorted(cams)]
    if len(same) > 1:
        raise ValueError(f"cams: {same[0]} and {same[1]} are the same cameras; remove one")
    return same[0] if same else None


def _recording(name: str) -> Path:
    shipped = sorted(f.name for f in RECORDINGS.glob("*") if f.is_dir())
    if name not in shipped:
        raise ValueError(f"recording: {name!r} is unknown; choose from {', '.join(shipped)}")
    return RECORDINGS / name


def pin(config: Mapping[str, Any]) -> dict[str, Any]:
    """A reward's config with the program's text in it, so that no file can change it.

    Raises:
        ValueError: as in ``load``.
    """
    if config.get("kind") not in KINDS:
        return dict(config)
    source = scaled(_source(config), config["unit"], "reward.unit")
    return {**config, "program": {"text": source.text, "origin": source.origin}}


def load(config: Mapping[str, Any]) -> Written:
    """The reward of a config whose ``kind`` is in ``KINDS``.

    Raises:
        ValueError: missing or unknown values, no such program, or one that is refused.
    """
    source = scaled(_source(config), config["unit"], "reward.unit")
    clip = _limits(config["clip"])
    try:
        program = compile_program(source.text)
    except ProgramError as error:
        raise ValueError(f"reward: {source.origin}, {error}") from error
    return Written(program, source.origin, clip)


def scaled(source: Source, unit: Any, key: str) -> Source:
    """A program whose scene units have so many metres; ``None`` leaves it as it is.

    Raises:
        ValueError: not a length, or a program that names none; ``key`` is what gave it.
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
    keys = _KEYS[kind] | {"kind"}
    if keys != set(config):
        odd = ", ".join(sorted(keys ^ set(config)))
        raise ValueError(
            f"reward: {odd} missing or unknown; {kind} takes {', '.join(sorted(_KEYS[kind]))}"
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
    """Study, results and shipped recording, in which a program is looked for."""
    study, recording = (
        strict.structure(config[key], str | None, f"reward.{key}") for key in ("study", "recording")
    )
    return study, strict.structure(config["results"], str, "reward.results"), recording


def read(path: Path) -> Source:
    """The program in a file.

    Raises:
        ValueError: no plain file there, or one that is too large, empty or no text.
    """
    try:
        return Source(read_text(path), str(path))
    except UnreadableError as error:
        raise ValueError(f"reward.path: {str(path)!r} {error}") from error
