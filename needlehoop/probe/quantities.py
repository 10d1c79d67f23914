"""What a probe reads off frames, from a task's phases: places, ways between them, and one fact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from needlehoop.tasks.contract import Task


@dataclass(frozen=True)
class Quantities:
    """Names, as tables and files have them. Made by ``quantities``."""

    task: str
    ends: Mapping[str, str]
    """By phase, in order: the fact that ends it."""
    origin: str
    """The signal that places are relative to: the second point of the last phase."""
    points: tuple[str, ...]
    """Signals whose places relative to the origin are read off: those of the last phase first."""
    gaps: Mapping[str, tuple[str, str]]
    """Ways between two of the points, by name."""
    needed: Mapping[str, str]
    """By phase: the point or the gap that has to be known in it."""

    @property
    def phases(self) -> tuple[str, ...]:
        """In order."""
        return tuple(self.ends)

    @property
    def fact(self) -> str:
        """The one that is read off: it ends the first phase."""
        return self.ends[self.phases[0]]

    @property
    def names(self) -> tuple[str, ...]:
        """Of all errors: in mm, but of ``fact`` the share of frames in which it is wrong."""
        return (*self.points, *self.gaps, self.fact)


def quantities(task: Task) -> Quantities:
    """What can be read off a task's frames.

    Raises:
        ValueError: a task without phases, or a phase whose points are not two places.
    """
    if not task.phases:
        raise ValueError(f"task {task.name} has no phases, so there is nothing to probe")
    for phase in task.phases:
        places = {name for name in phase.points if task.signals[name].shape == (3,)}
        if len(places) < 2:
            found = ", ".join(phase.points)
            raise ValueError(f"task {task.name}: phase {phase.name}: no two places: {found}")
    origin = task.phases[-1].points[1]
    points = (name for phase in reversed(task.phases) for name in phase.points)
    gaps: dict[str, tuple[str, str]] = {}
    needed = {}
    for phase in task.phases:
        ends = [name for name in phase.points if name != origin]
        if len(ends) == 1:
            needed[phase.name] = ends[0]
            continue
        name = _gap(*phase.points)
        if gaps.get(name, phase.points) != phase.points:
            name = "_to_".join(phase.points)
        gaps[name], needed[phase.name] = phase.points, name
    return Quantities(
        task=task.name,
        ends={phase.name: phase.ends for phase in task.phases},
        origin=origin,
        points=tuple(dict.fromkeys(name for name in points if name != origin)),
        gaps=gaps,
        needed=needed,
    )


def _gap(one: str, other: str) -> str:
    """A short name: ``tool_to_block`` from ``tool_midpoint`` and ``block_position``."""
    return f"{one.partition('_')[0]}_to_{other.partition('_')[0]}"
