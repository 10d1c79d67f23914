"""The texts that a model is shown, as files, and which edition of them a record was made with."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from needlehoop.runs.machine import commit
from needlehoop.runs.reading import read_json
from needlehoop.runs.run import Run

EDITION = "prompts.json"
"""The note beside a transcript that says which prompts were asked there."""


def fill(name: str, **values: object) -> str:
    """The prompt ``<name>.txt`` with its ``$gaps`` filled.

    Raises:
        ValueError: gaps and values are not the same.
    """
    template = Template(files(__name__).joinpath(f"{name}.txt").read_text(encoding="utf-8"))
    gaps = set(template.get_identifiers())
    if gaps != set(values):
        odd = ", ".join(sorted(gaps ^ set(values)))
        raise ValueError(f"prompt {name}: {odd} missing or not asked for")
    return template.substitute({key: str(value) for key, value in values.items()}).strip()


@dataclass(frozen=True)
class Edition:
    """The prompts' texts at some commit.

    ``sha256`` is the hash of the prompts' files. It tells editions apart; the commit does not,
    because most commits change no prompt. ``commit`` is ``None`` outside git.
    """

    commit: str | None
    sha256: str

    def __str__(self) -> str:
        return f"commit {self.commit}" if self.commit else f"sha256 {self.sha256[:12]}"


def sha256() -> str:
    """The hash of all prompts' files, names included."""
    digest = hashlib.sha256()
    texts = [file for file in files(__name__).iterdir() if file.name.endswith(".txt")]
    for file in sorted(texts, key=lambda file: file.name):
        digest.update(f"{file.name}\0{file.read_text(encoding='utf-8')}\0".encode())
    return digest.hexdigest()


def sign(folder: Path) -> None:
    """Note in a record's folder that the present prompts were asked there.

    The note of an earlier edition is kept under a number.
    """
    known = edition(folder)
    if known is None or known.sha256 != sha256():
        text = json.dumps(asdict(Edition(commit(), sha256())), indent=2)
        Run(folder).write(EDITION, text + "\n")


def edition(folder: Path) -> Edition | None:
    """The edition that a record was last made with; ``None`` if it has no note.

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


def other_edition(folder: Path) -> str | None:
    """What a message says of a record that was made with other prompts; ``None`` if it was not."""
    made_with = edition(folder)
    if made_with is None or made_with.sha256 == sha256():
        return None
    return (
        f"was recorded with the prompts of {made_with}, and these are others: replay it there, or"
        " ask anew into another study="
    )
