"""Tasks by name: the folders of this package, and those that somebody brought.

Built-in tasks are found by name. A task from elsewhere is code: it is imported by ``add_folder`` or
``add_installed`` alone, for somebody who named it.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import iter_modules

from needlehoop import tasks
from needlehoop.runs.shipped import CONF
from needlehoop.tasks.contract import Task

GROUP = "needlehoop.tasks"
"""Entry points of installed packages: ``mine = "my_package.my_task:TASK"``."""

_added: dict[str, Task] = {}
_folders: dict[str, Path] = {}
"""Of tasks that were added from a folder."""


def built_in() -> tuple[str, ...]:
    """Names of the tasks of this package."""
    return tuple(sorted(one.name for one in iter_modules(tasks.__path__) if one.ispkg))


def names() -> tuple[str, ...]:
    """Names of all tasks that can be found."""
    return (*built_in(), *sorted(_added))


def find(name: object) -> Task:
    """A task by its name; imports nothing from elsewhere.

    Raises:
        ValueError: there is none; the message lists those that there are.
    """
    if isinstance(name, str) and name in _added:
        return _added[name]
    if name not in built_in():
        raise ValueError(
            f"task.name: {name!r} is unknown; choose from {', '.join(names())}, or name the folder"
            " of your own task with task_dir="
        )
    return import_module(f"needlehoop.tasks.{name}").TASK


def conf_of(name: str) -> Path:
    """The config folder with a task's options: ours, or that in the folder it was added from."""
    return _folders[name] / "conf" if name in _folders else CONF


def add_folder(folder: Path) -> Task:
    """Import a task from a folder: a Python package whose ``TASK`` it is.

    Raises:
        ValueError: no such package, an error in it, or a task that leaves something out.
    """
    place = folder.expanduser().resolve()
    module = f"needlehoop_task_{place.name}"
    file = place / "__init__.py"
    known = sys.modules.get(module)
    if known is not None and getattr(known, "__file__", None) == str(file):
        return _added[known.TASK.name]
    spec = spec_from_file_location(module, file, submodule_search_locations=[str(place)])
    if not file.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"task_dir: {str(folder)!r} is no folder with an __init__.py")
    sys.modules[module] = loaded = module_from_spec(spec)
    try:
        spec.loader.exec_module(loaded)
        task = _add(getattr(loaded, "TASK", None), f"task_dir: {str(folder)!r}")
    except Exception as error:
        del sys.modules[module]
        # Whatever a stranger's module can fail with, told in a line.
        raise ValueError(f"task_dir: {str(folder)!r}: {error}") from error
    _folders[task.name] = place
    return task


def add_installed(name: str) -> Task | None:
    """Import the task of an installed package; ``None`` where none has one of that name."""
    found = tuple(entry_points(group=GROUP, name=name))
    if not found:
        return None
    return _add(found[0].load(), f"the entry point {name} ({found[0].value})")


def _add(task: object, origin: str) -> Task:
    if not isinstance(task, Task):
        raise ValueError(f"{origin} has no TASK: give a needlehoop.tasks.contract.Task")
    if task.name in built_in():
        raise ValueError(f"{origin}: the name {task.name!r} is taken; choose another")
    _added[task.name] = task
    return task
