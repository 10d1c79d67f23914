"""What became of the jobs of sweeps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from needlehoop.runs.files import OUTCOME, SWEEPS
from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.study.data.contents import checked
from needlehoop.study.data.records import LeftOut, Place


@dataclass(frozen=True)
class _Note:
    """What a sweep's job leaves."""

    study: str
    cameras: str
    reward: str
    seed: int
    outcome: str
    error: str | None = None


def read_job_ends(study: Path) -> tuple[dict[Place, tuple[float, str | None]], list[LeftOut]]:
    """The newest end of each run that sweeps have tried for a study, which may have no folder yet.

    Returns:
        By run, when it ended (Unix time, s) and why it failed, if it did; then the notes that
        cannot be read.
    """
    root = study.resolve().parent / SWEEPS
    found: dict[Place, tuple[float, str | None]] = {}
    left_out: list[LeftOut] = []
    # The newest comes last.
    for when, path in sorted((one.lstat().st_mtime, one) for one in root.glob(f"*/*/{OUTCOME}")):
        try:
            note: _Note = checked(_Note, read_json(path))
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / path.relative_to(root.parent), str(error)))
            continue
        if note.study == study.resolve().name:
            found[Place(note.cameras, note.reward, note.seed)] = when, note.error
    return found, left_out
