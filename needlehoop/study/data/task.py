"""What a run's manifest says of its task: names of facts and phases."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from needlehoop.runs.reading import UnreadableError

_NAME = re.compile(r"\w[\w -]{0,39}")
"""Of a task, a fact or a phase: figures and tables have room for it."""

_MOST = 100
"""Facts or phases."""


@dataclass(frozen=True)
class TaskNote:
    """What the study needs of a task; a run writes it down when it is created."""

    name: str
    goal: str
    """The fact that says that the task is done."""
    columns: tuple[str, ...]
    """Names in ``metrics.csv`` and evaluations of what was true at an episode's end."""
    phases: tuple[tuple[str, str], ...]
    """Parts of the task in their order: name, and the fact that ends it."""


UNKNOWN = TaskNote("", "success", ("success",), ())
"""Of a run whose manifest does not say."""


def task_of(manifest: Mapping[str, Any]) -> TaskNote:
    """What a manifest says of the task.

    Raises:
        UnreadableError: nothing, or nothing that can be used.
    """
    found = manifest.get("task")
    if found is None:
        raise UnreadableError("says nothing of the task: its phases and cheats are not known")
    if not isinstance(found, Mapping):
        raise UnreadableError("has no usable task")
    columns = tuple(map(_name, _list(found.get("columns"))))
    phases = tuple(map(_phase, _list(found.get("phases"))))
    note = TaskNote(_name(found.get("name")), _name(found.get("goal")), columns, phases)
    told = {"success", note.goal, *(fact for _, fact in phases)}
    if not told <= {*columns} or ("cheat" in columns) is not found.get("cheat"):
        raise UnreadableError("has no usable task")
    return note


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list) or len(value) > _MOST:
        raise UnreadableError("has no usable task")
    return value


def _name(value: Any) -> str:
    if not (isinstance(value, str) and _NAME.fullmatch(value)):
        raise UnreadableError("has no usable task")
    return value


def _phase(value: Any) -> tuple[str, str]:
    """Its name, and the fact that ends it."""
    both = _list(value)
    if len(both) != 2:
        raise UnreadableError("has no usable task")
    return _name(both[0]), _name(both[1])
