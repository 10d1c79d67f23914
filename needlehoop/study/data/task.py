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
    columns, phases = found.get("columns"), found.get("phases")
    names = (found.get("name"), found.get("goal"))
    usable = (
        all(map(_is_name, names))
        and isinstance(columns, list)
        and len(columns) <= _MOST
        and all(map(_is_name, columns))
        and {"success", found["goal"]} <= {*columns}
        and ("cheat" in columns) is found.get("cheat")
        and isinstance(phases, list)
        and len(phases) <= _MOST
        and all(_is_phase(one, columns) for one in phases)
    )
    if not usable:
        raise UnreadableError("has no usable task")
    return TaskNote(*names, tuple(columns), tuple((name, fact) for name, fact in phases))


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and _NAME.fullmatch(value) is not None


def _is_phase(value: Any, columns: list[str]) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(map(_is_name, value))
        and value[1] in columns
    )
