"""What became of the jobs of sweeps, from the notes that they leave beside the studies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlehoop.runs.files import OUTCOME, SWEEPS
from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.study.data.records import LeftOut, Place

_KINDS = {"study": str, "cameras": str, "reward": str, "seed": int, "outcome": str}


@dataclass(frozen=True)
class Outcome:
    """How a sweep's last try at a run ended."""

    when: float
    """Unix time, s."""
    error: str | None
    """Why it failed; ``None``: it did not."""


def read_outcomes(study: Path) -> tuple[dict[Place, Outcome], list[LeftOut]]:
    """The newest outcome of each run that sweeps have tried for a study.

    Args:
        study: the study's folder, whether there already or not.

    Returns:
        Outcomes by run, and the notes that can't be read.
    """
    root = study.resolve().parent / SWEEPS
    found: dict[Place, Outcome] = {}
    left_out: list[LeftOut] = []
    for path in sorted(root.glob(f"*/*/{OUTCOME}")):
        try:
            note = _read(path)
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / path.relative_to(root.parent), str(error)))
            continue
        place = Place(note["cameras"], note["reward"], note["seed"])
        outcome = Outcome(path.stat().st_mtime, note.get("error"))
        if note["study"] == study.resolve().name and (
            place not in found or found[place].when < outcome.when
        ):
            found[place] = outcome
    return found, left_out


def _read(path: Path) -> Mapping[str, Any]:
    note = read_json(path)
    kinds = {**_KINDS, **({"error": str} if "error" in note else {})}
    odd = [key for key, kind in kinds.items() if not isinstance(note.get(key), kind)]
    if odd:
        raise UnreadableError(f"has no usable {', '.join(odd)}")
    return note
