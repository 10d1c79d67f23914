"""Rewards that are programs: a user's file, or what a vision-language model (VLM) wrote."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Count, Names, OneOf, Positive, Real
from needlehoop.rewards.language.program import Program, ProgramError, compile_program
from needlehoop.rewards.terms import check_finite, potential
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.runs.shipped import RECORDINGS

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signal, Signals

FLAVOURS = {"vlm_text": "text", "vlm_img": "image"}
"""What a VLM was shown when it wrote a reward, by the reward's kind."""

Flavour = Annotated[str, OneOf(*FLAVOURS.values())]

KINDS = ("file", *FLAVOURS)

_UNIT = re.compile(r"^unit = [0-9.e-]+$", re.MULTILINE)
"""The line of a program that gives the size of a scene unit in metres."""


class NotWrittenError(ValueError):
    """A program that does not exist yet; a model can be asked for it."""


@dataclass(frozen=True)
class ProgramReward:
    """A program in use, and where its text came from. Its terms must be finite.

    ``clip``: the least and the most that the total may be; the term ``clipped`` makes it so.
    """

    program: Program
    origin: str
    clip: tuple[float, float] | None = None

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name; errors as in ``check_finite``."""
        terms = self.program(signals)
        check_finite(terms, f"the program from {self.origin}")
        if self.clip is None:
            return terms
        total = potential(terms)
        name = "clipped"
        while name in terms:
            name += "_1"
        return {**terms, name: total.clamp(*self.clip) - total}

    def text(self) -> str:
        """For the record: the program's origin and its source."""
        confined = f", clipped to {self.clip[0]:g} to {self.clip[1]:g}" if self.clip else ""
        return f"# From {self.origin}{confined}.\n{self.program.source}"


@dataclass(frozen=True)
class Source:
    """A program's text and where it came from."""

    text: str
    origin: str


@dataclass(frozen=True)
class _Config:
    kind: str
    unit: Positive | None
    clip: tuple[Real, Real] | None
    program: Source | None
    """A run's own."""

    def __post_init__(self) -> None:
        if self.clip is not None and not self.clip[0] < self.clip[1]:
            raise ValueError(f"reward.clip: {self.clip[0]:g} must be below {self.clip[1]:g}")


@dataclass(frozen=True)
class _File(_Config):
    path: str


@dataclass(frozen=True)
class _Recorded(_Config):
    cams: Names
    results: str
    study: str | None
    recording: str | None
    sample: Count


def _read(config: Mapping[str, Any]) -> tuple[Source, tuple[float, float] | None]:
    """The pinned program, or the one that the config points at, in its unit; and its clip."""
    values = {key: value for key, value in config.items() if key != "name"}
    spec: Any = strict.structure(values, _File if config["kind"] == "file" else _Recorded, "reward")
    source = spec.program
    if source is None and spec.kind == "file":
        source = read(Path(spec.path))
    elif source is None:
        place = spec.study, spec.results, spec.recording
        source = find(spec.cams, FLAVOURS[spec.kind], *place, spec.sample)
    return scaled(source, spec.unit, "reward.unit"), spec.clip


def load(config: Mapping[str, Any], table: Mapping[str, Signal]) -> ProgramReward:
    """The reward of a config whose ``kind`` is in ``KINDS``; its program may read ``table``.

    ``ValueError``: missing or unknown values, no such program, or one that is refused.
    """
    source, clip = _read(config)
    try:
        program = compile_program(source.text, table)
    except ProgramError as error:
        raise ValueError(f"reward: {source.origin}, {error}") from error
    return ProgramReward(program, source.origin, clip)


def with_source(config: Mapping[str, Any]) -> dict[str, Any]:
    """A config with the program's text in it, which no file changes; errors as in ``load``."""
    return {**config, "program": asdict(_read(config)[0])}


def is_recorded(config: Mapping[str, Any]) -> bool:
    """Whether a config's program exists; ``ValueError`` for one that no model could write."""
    if config["kind"] not in FLAVOURS:
        return True
    try:
        _read(config)
    except NotWrittenError:
        return False
    return True


def read(path: Path) -> Source:
    """The program in a file; ``ValueError`` if it can't be read."""
    try:
        return Source(read_text(path), str(path))
    except UnreadableError as error:
        raise ValueError(f"reward.path: {error}") from error


def scaled(source: Source, unit: float | None, key: str) -> Source:
    """A program with another unit of its scene, m (``None``: its own).

    ``ValueError``: it has no line that gives its scene unit; ``key`` is what the message names.
    """
    if unit is None:
        return source
    if len(_UNIT.findall(source.text)) != 1:
        raise ValueError(
            f"{key}: {source.origin} has no line such as unit = 0.05 to put {unit} into;"
            " leave it null"
        )
    return replace(source, text=_UNIT.sub(f"unit = {float(unit)!r}", source.text))


def find(
    cams: Sequence[str],
    flavour: str,
    study: str | None,
    results: str,
    recording: str | None,
    sample: int = 1,
) -> Source:
    """The program that was written for a camera set, in any order.

    First choice is the study's, ``<results>/<study>/vlm/rewards/<cameras>/<flavour>.txt``, then
    the recording's, ``needlehoop/recordings/<recording>/rewards/<cameras>/<flavour>.txt``; either
    may be ``None``. A ``text`` program may also be in the folder ``any``.

    ``NotWrittenError``: no program; the message has the command that makes it. ``ValueError``: an
    unknown recording, or no program and no study to write one into.
    """
    chosen, name = sorted(cams), file_name(flavour, sample)
    folders = [] if study is None else [Path(results) / study / "vlm" / "rewards"]
    if recording is not None:
        shipped = sorted(f.name for f in RECORDINGS.glob("*") if f.is_dir())
        strict.check_names("recording", [recording], shipped)
        folders.append(RECORDINGS / recording / "rewards")
    known = set()
    for folder in folders:
        files = {file.parent.name: file for file in sorted(folder.glob(f"*/{name}"))}
        known |= {*files}
        fits = [cameras for cameras in files if sorted(cameras.split("+")) == chosen]
        if flavour == "text" and "any" in files:
            fits.append("any")
        if fits:
            return read(files[fits[0]])
    which = "" if sample == 1 else f" (sample {sample})"
    missing = (
        f"cams: no {flavour} reward{which} is recorded for {'+'.join(cams) or 'no cameras'}"
        f" (there is {', '.join(sorted(known)) or 'none'})"
    )
    if study is None:
        raise ValueError(f"{missing}; with reward.study=null no model can write one")
    place = f"study={study}" + ("" if results == "results" else f" results={results}")
    place += "" if sample == 1 else f" samples={sample}"
    raise NotWrittenError(
        f"{missing}; make one with: needlehoop vlm reward 'cams=[{','.join(cams)}]'"
        f" flavour={flavour} {place} vlm=gemini"
    )


def file_name(flavour: str, sample: int) -> str:
    return f"{flavour}.txt" if sample == 1 else f"{flavour}_{sample}.txt"
