"""Options that follow from the task: ``episode=default`` and ``reward=human`` are its own.

Their files are ``conf/episode/<task>.yaml`` and ``conf/reward/human/<task>.yaml``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore

from needlehoop.runs.reading import UnreadableError, read_yaml

OPTIONS = {"episode": ("default", "episode"), "reward": ("human", "reward/human")}
"""By group: the option, and the folder of its files below a config folder."""

STANDARD = "standard"
"""The task's option where none is named."""

_DEEPEST = 8
"""Files that a task's option may build on, one on the other."""


def register(words: Iterable[str], folders: Sequence[Path], task: str | None = None) -> None:
    """Tell Hydra what the options are for the task that a command line names.

    Args:
        folders: config folders, ours first.
        task: by its name, where a run and not the command line decides it.

    Raises:
        ValueError: a sweep over different tasks, or a file that cannot be read.
    """
    chosen = [w.partition("=")[2] for w in words if w.lstrip("+").startswith("task=")]
    options = chosen[-1].split(",") if chosen else [STANDARD]
    found = [task] if task else (task_name(option, folders) for option in options)
    names = {name for name in found if name is not None}
    if len(names) > 1:
        raise ValueError(f"task: a sweep is over one task's variants, not {', '.join(names)}")
    store = ConfigStore.instance()
    for group, (option, place) in OPTIONS.items():
        for name in names:
            file = _file(folders, place, name)
            if file is not None:
                store.store(group=group, name=option, node=_read(file))


def task_name(option: str, folders: Sequence[Path]) -> str | None:
    """The task of an option of the group ``task``; ``None`` where there is no such option.

    An option names its task or builds on one that does.
    """
    for _ in range(_DEEPEST):
        file = _file(folders, "task", option)
        if file is None:
            return None
        values = _read(file)
        if "name" in values:
            return str(values["name"])
        below = [one for one in values.get("defaults") or [] if one != "_self_"]
        if not below or not isinstance(below[0], str):
            return None
        option = below[0].partition("@")[0]
    return None


def variants(name: str, folders: Sequence[Path]) -> list[str]:
    """What ``task=`` may be for a task by its name: options that name it or build on such."""
    found = {
        str(file.relative_to(folder / "task").with_suffix(""))
        for folder in folders
        for file in (folder / "task").rglob("*.yaml")
    }
    return sorted(option for option in found if task_name(option, folders) == name)


def _file(folders: Sequence[Path], place: str, name: str) -> Path | None:
    files = (folder / place / f"{name}.yaml" for folder in folders)
    return next((file for file in files if file.is_file()), None)


def _read(file: Path) -> dict[str, Any]:
    try:
        return read_yaml(file)
    except UnreadableError as error:
        raise ValueError(f"{file} {error}") from error
