"""Tasks by name: the folders of this package, and those from elsewhere.

A task from elsewhere is somebody's code: only ``add`` imports it.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from needlehoop.config.options import TASKS
from needlehoop.runs.shipped import CONF
from needlehoop.tasks import built_in
from needlehoop.tasks.contract import Task

_added: dict[str, tuple[Task, Path]] = {}
"""Tasks from elsewhere, and the folders with their ``conf``."""


def names() -> tuple[str, ...]:
    """Names of all tasks that can be found."""
    return (*built_in(), *sorted(_added))


def find(name: object) -> Task:
    """A built-in or added task by its name.

    Raises:
        ValueError: there is none; the message lists those that there are.
    """
    if isinstance(name, str) and name in _added:
        return _added[name][0]
    if name not in built_in():
        raise ValueError(
            f"task.name: {name!r} is unknown; choose from {', '.join(names())}, or name the folder"
            " of your own task with task_dir="
        )
    return import_module(f"needlehoop.tasks.{name}").TASK


def conf_of(name: str) -> Path:
    """The config folder with a task's options: ours, or the one beside its module."""
    return _added[name][1] / "conf" if name in _added else CONF


def is_from_elsewhere(name: object, folder: str | None) -> bool:
    """Whether ``add`` would import something for a task's name and ``task_dir``."""
    return folder is not None or _entry(name) is not None


def add(name: object, folder: str | None) -> None:
    """Import a task from ``task_dir`` or an installed package; a built-in task needs no import.

    Raises:
        ValueError: no such task, an error in its code, or a task that leaves something out.
    """
    if folder is not None:
        task = add_folder(Path(folder))
    elif entry := _entry(name):
        task = _add_installed(entry)
    else:
        return
    if task.name != name:
        origin = folder or f"the entry point {name}"
        raise ValueError(f"task: {name!r} was chosen, and {origin} has {task.name!r}")


def add_folder(folder: Path) -> Task:
    """Import a task from a folder: a Python package whose ``TASK`` it is; errors as in ``add``."""
    place = folder.expanduser().resolve()
    origin = f"task_dir: {str(folder)!r}"
    for task, at in _added.values():
        if at == place:
            return task
    module, file = f"needlehoop_task_{place.name}", place / "__init__.py"
    spec = spec_from_file_location(module, file, submodule_search_locations=[str(place)])
    if not file.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"{origin} is no folder with an __init__.py")
    # Another folder of that name may have been here.
    _forget(module)
    sys.modules[module] = loaded = module_from_spec(spec)
    try:
        spec.loader.exec_module(loaded)
    except Exception as error:
        _forget(module)
        raise ValueError(f"{origin}: {error}") from error
    return _add(getattr(loaded, "TASK", None), place, origin)


def _entry(name: object) -> Any:
    """The entry point of an installed package's task, if there is one."""
    entries = () if name in built_in() else entry_points(group=TASKS, name=str(name))
    return next(iter(entries), None)


def _add_installed(entry: Any) -> Task:
    origin = f"the entry point {entry.name} ({entry.value})"
    try:
        task = entry.load()
    except Exception as error:
        raise ValueError(f"{origin}: {error}") from error
    return _add(task, Path(sys.modules[entry.module].__file__ or "").parent, origin)


def _add(task: object, place: Path, origin: str) -> Task:
    if not isinstance(task, Task):
        raise ValueError(f"{origin} has no TASK: give a needlehoop.tasks.contract.Task")
    if task.name in built_in():
        raise ValueError(f"{origin}: the name {task.name!r} is taken; choose another")
    _added[task.name] = task, place
    return task


def _forget(module: str) -> None:
    for name in [key for key in sys.modules if f"{key}.".startswith(f"{module}.")]:
        del sys.modules[name]
