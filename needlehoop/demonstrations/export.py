"""A dataset's folder: made whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from needlehoop.config.strict import check_names
from needlehoop.demonstrations.episodes import About, Demonstration

FORMATS = ("minari", "lerobot")


Layout = Callable[[Path, Iterable[Demonstration], About], None]
"""Writes all of some episodes into a folder, which is empty."""


def layout(name: str) -> Layout:
    """How datasets of a format are written.

    Raises:
        ValueError: an unknown format, or one whose library is not installed.
    """
    check_names("format", [name], FORMATS)
    try:
        if name == "minari":
            from needlehoop.demonstrations.minari_layout import write
        else:
            from needlehoop.demonstrations.lerobot_layout import write
    except ModuleNotFoundError as error:
        raise ValueError(
            f"format={name} needs {error.name}: pip install 'needlehoop[{name}]'"
        ) from error
    return write


@contextmanager
def new_folder(out: Path, overwrite: bool) -> Iterator[Path]:
    """A folder to write into, which becomes ``out`` when all went well and else vanishes.

    Args:
        out: what it is to be called.
        overwrite: whether something of that name may be replaced, once there is something new.

    Raises:
        ValueError: there is something, and ``overwrite`` is false.
    """
    if out.exists() and not overwrite:
        raise ValueError(f"out: {str(out)!r} exists; choose another or say overwrite=true")
    partial = out.with_name(out.name + ".partial")
    # What a killed export left.
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        if out.is_dir():
            shutil.rmtree(out)
        partial.replace(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
