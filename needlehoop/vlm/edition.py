"""Which edition of the prompts a record was made with, so that a miss can say it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path

from needlehoop.runs.provenance import commit
from needlehoop.runs.reading import read_json
from needlehoop.runs.run import Run
from needlehoop.vlm import prompts

EDITION = "prompts.json"
"""Beside a transcript."""


@dataclass(frozen=True)
class Edition:
    """The prompts' texts at some commit.

    ``sha256`` is of the files in ``prompts/``; it tells editions apart where the commit,
    which most other changes move as well, cannot. ``commit`` is ``None`` outside git.
    """

    commit: str | None
    sha256: str

    def __str__(self) -> str:
        return f"commit {self.commit}" if self.commit else f"sha256 {self.sha256[:12]}"


def sha256() -> str:
    """Of all prompts' files, names included."""
    digest = hashlib.sha256()
    texts = [file for file in files(prompts).iterdir() if file.name.endswith(".txt")]
    for file in sorted(texts, key=lambda file: file.name):
        digest.update(f"{file.name}\0{file.read_text(encoding='utf-8')}\0".encode())
    return digest.hexdigest()


def sign(folder: Path) -> None:
    """Note in a record's folder that the present prompts were asked there.

    The note of an earlier edition is kept under a number.
    """
    known = read(folder)
    if known is None or known.sha256 != sha256():
        text = json.dumps(asdict(Edition(commit(), sha256())), indent=2)
        Run(folder).write(EDITION, text + "\n")


def read(folder: Path) -> Edition | None:
    """The edition that a record was made with last; ``None``: it does not say.

    Raises:
        ValueError: the note is damaged.
    """
    path = folder / EDITION
    if not path.is_file():
        return None
    try:
        return Edition(**read_json(path))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: not the note of an edition: {error}") from error


def others(folder: Path) -> str | None:
    """What to say of a record that was made with other prompts; ``None`` if it was not."""
    made_with = read(folder)
    if made_with is None or made_with.sha256 == sha256():
        return None
    return (
        f"was recorded with the prompts of {made_with}, and these are others: replay it there, or"
        " ask anew into another study="
    )
