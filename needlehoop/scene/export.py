"""A folder with a scene in it, for those who have MuJoCo and none of our Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from needlehoop.config import strict
from needlehoop.runs.reading import read_json

RECORD = "export.json"
"""What of a folder's files was written by an export."""

_PAPERS = Path(__file__).parents[1] / "robot"


def papers() -> dict[str, str]:
    """What goes with every model: the licence, and where the arm's numbers are from."""
    return {name: (_PAPERS / name).read_text("utf-8") for name in ("LICENSE", "README.md")}


def check_place(out: Path, overwrite: bool) -> None:
    """Raises ``ValueError`` where an export may not be written; see ``write_folder``."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"out: {str(out)!r} is a file; name a folder")
    if out.exists() and not overwrite:
        raise ValueError(f"out: {str(out)!r} exists; choose another or say overwrite=true")


def write_folder(out: Path, files: Mapping[str, str], overwrite: bool) -> None:
    """Write files below a folder, all of them or none.

    Args:
        out: the folder; it is made. In one that exists only what an export has written is
            replaced, and nothing is deleted.
        files: texts by path below ``out``.
        overwrite: whether ``out`` may exist.

    Raises:
        ValueError: ``out`` exists, or a file in it that no export has written is in the way.
    """
    check_place(out, overwrite)
    own = _written_before(out)
    foreign = sorted(name for name in files if (out / name).exists() and name not in own)
    if foreign:
        raise ValueError(
            f"out: {str(out / foreign[0])!r} was not written by an export; choose another folder"
        )
    record = json.dumps({"files": sorted({*own, *files})}, indent=2) + "\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside:
        fresh = Path(beside) / "fresh"
        # The record first: what is cut off half-way can be written over again.
        for name, text in {RECORD: record, **files}.items():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).write_text(text, "utf-8")
        if not out.exists():
            fresh.rename(out)
            return
        for name in (RECORD, *files):
            (out / name).parent.mkdir(exist_ok=True)
            (fresh / name).replace(out / name)


def _written_before(out: Path) -> set[str]:
    try:
        found = read_json(out / RECORD)["files"] if (out / RECORD).exists() else []
        return set(strict.structure(found, tuple[str, ...], "files"))
    except (ValueError, KeyError) as error:
        raise ValueError(f"out: {str(out / RECORD)!r} is no record of an export") from error
