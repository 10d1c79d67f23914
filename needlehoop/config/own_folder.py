"""A config folder of one's own: ``conf_dir=<folder>``, views, tasks and all, beside ``conf/``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from needlehoop.config import camera_groups
from needlehoop.runs.shipped import CONF

KEY = "conf_dir"


def part(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line without ``conf_dir=``, and the folders that it named.

    Raises:
        ValueError: one that is no config folder, or has a name that is taken.
    """
    given = list(words)
    own = [word for word in given if word.startswith(f"{KEY}=")]
    folders = [Path(word.partition("=")[2]).expanduser().resolve() for word in own]
    for folder in folders:
        _check(folder)
    return [word for word in given if word not in own], folders


def _check(folder: Path) -> None:
    """Raises ``ValueError`` for what Hydra would leave aside without a word."""
    if not folder.is_dir():
        raise ValueError(f"{KEY}: {str(folder)!r} is no folder")
    valid = sorted(one.name for one in CONF.iterdir() if one.is_dir())
    for group in sorted(one.name for one in folder.iterdir() if one.is_dir()):
        if group not in valid:
            raise ValueError(f"{KEY}: {group!r} is no group; choose from {', '.join(valid)}")
        own, ours = (camera_groups.options(place, group) for place in (folder, CONF))
        for name in sorted({*own} & {*ours}):
            raise ValueError(f"{KEY}: {group}/{name}.yaml: the name is taken; choose another")
