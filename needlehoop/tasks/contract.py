"""What a task gives. The rest of the package reads this and knows no task by name.

Functions are pure and batched: tensors with a leading dimension of ``n`` environments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from torch import Tensor

from needlehoop.scene.signals import Signal
from needlehoop.scene.spec import Materials
from needlehoop.tasks.layout import Episode, Layout
from needlehoop.tasks.start import Chance, Start

Memory = Any
"""What is remembered between steps, a TensorDict of batch size ``(n,)``: the robot's targets,
``steps`` taken, and what ``Fact`` asks for."""

Controller = Callable[[Any], Tensor]
"""Signals to actions ``(n, action_size)``."""

DIVERGED = "diverged"
"""A fact of every task: the physics broke down."""


class Weld(NamedTuple):
    """What a weld between two bodies becomes."""

    changed: Tensor
    """``(n,)`` bool."""
    active: Tensor
    """``(n,)`` bool."""
    pose: Tensor
    """``(n, 7)``: the second body in the first one's frame, position in m and quaternion."""


@dataclass(frozen=True)
class Fact:
    """Something that is true of a moment or not; a row of the table of signals."""

    name: str
    meaning: str
    verdict: bool = False
    """Whether it is the answer, which reward programs may not see."""
    remembered: bool = False
    """Whether the memory keeps its value for the next ``observe``."""
    once: bool = False
    """Whether the memory has ``has_<name>``: it was true at some time of the episode. A run's
    tables report that in its place."""
    timed: bool = False
    """Whether the memory has ``<name>_since``: the number of steps taken when it was last false."""


@dataclass(frozen=True)
class Phase:
    """A part of the task."""

    name: str
    ends: str
    """The fact that ends it."""
    points: tuple[str, str]
    """Signals whose distance matters in it."""


@dataclass(frozen=True)
class FlatClass:
    """Bodies, with all that hangs on them, that a flat rendering paints in one colour."""

    bodies: tuple[str, ...]
    colour: tuple[int, int, int]
    """RGB, 0 to 255; a rendering may name another."""


def at_commands(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
    """Writes a start's servo commands into the joints that the servos hold, all of them."""
    columns = model.jnt_qposadr[model.actuator_trnid[:, 0]]

    def write(qpos: np.ndarray, start: Start) -> None:
        qpos[:, columns] = start.control.numpy()

    return write


class Part(NamedTuple):
    """How a prompt describes a robot's body that a camera is mounted on."""

    name: str
    """Such as ``the forearm``."""
    along: tuple[float, float, float]
    """Unit vector along it towards the tip, in the body's frame."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """Arms, and how actions move them."""

    model: Callable[[Any, str], mujoco.MjSpec]
    """From a layout and the setting ``psm``: its bodies, joints, servos and materials, to which
    the rest of the scene is added."""
    poser: Callable[[mujoco.MjModel], Callable[[np.ndarray, Start], None]] = at_commands
    """For a compiled scene: a function that writes a start's robot into ``qpos`` ``(k, nq)``."""
    begin: Callable[[Any, Start], dict[str, Tensor]] = lambda rules, start: {
        name: value.clone() for name, value in start.robot.items()
    }
    """From rules and a start: its part of the memory."""
    act: Callable[[Any, Any, Memory, Tensor], tuple[dict[str, Tensor], Tensor]]
    """From layout, rules, memory and an action ``(n, action_size)``: its part of the memory now,
    and the servos' commands ``(n, nu)``."""
    table: Callable[[Mapping[str, Signal], str | None], Mapping[str, Signal]]
    """From the task's signals and the body that may be held: all signals, with the robot's
    sensors, touches and commands."""
    commands: Mapping[str, str]
    """Signals that are read from the memory, and their names there."""
    body: str
    """Root of its bodies: class ``robot`` of flat renderings."""
    proprio: tuple[str, ...]
    """Signals that it knows of itself."""
    displaced: Callable[[Any, Any, Memory, Tensor], Tensor] | None = None
    """From layout, rules, memory and an offset ``(n, 3)``, m: the servos' commands that put the
    tip beside its target. ``None``: ``disturb.robot.offset`` is refused."""
    parts: Mapping[str, Part] = field(default_factory=dict)
    """Descriptions of bodies for cameras that are mounted on them."""
    opens: tuple[int, ...] = ()
    """Indices of the actions that let go where they are 1; empty: nothing is ever held. Actions of
    0 hold still."""
    label: str = ""
    """Its name in datasets, such as ``dvrk_psm``; empty: ``body``."""
    tool: str = ""
    """The instrument's name in datasets."""
    actions: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names of an action's numbers, by ``episode.control``; for datasets."""


@dataclass(frozen=True)
class Telling:
    """How a task is described to a vision-language model.

    These texts go into the general prompts, ``needlehoop/vlm/prompts``. They must not give away
    the human reward or the limits that decide success.
    """

    texts: Path
    """Folder of texts with ``$gaps``. ``scene.txt``: the scene and the task. ``signals.txt``: the
    numbers behind the signals, a line ``- …`` each. ``<fact>.txt``, for some of ``moments``: the
    question which camera shows the fact best."""
    values: Callable[[Any, Any], Mapping[str, object]]
    """From layout and rules: values of the gaps, by name; and ``control``: what an agent does at
    every step, such as ``moves the tip by up to 6 mm``."""
    goal: str
    """The picture of the goal in words, such as ``the cube is on the spot``."""
    done: str
    """The same without the test of success: ``the cube is where it has to be``."""
    front: str
    """What the views at azimuth 0 are in front of, such as ``the spot``."""
    moments: Mapping[str, str] = field(default_factory=dict)
    """Facts whose first moments are pictured after the start and before the goal, in order, each
    in words, such as ``the cube has just been grasped``."""
    painted: Mapping[str, str] = field(default_factory=dict)
    """Remarks on classes of flat renderings, by class."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task. ``needlehoop tasks`` prints it; ``docs/own-task.md`` walks through one."""

    name: str
    summary: str
    """One sentence."""
    robot: Robot
    layout: type[Layout]
    """Sizes, placement, scatter; values in ``conf/task``."""
    rules: type[Episode]
    """Control, thresholds, what success is; values in ``conf/episode``."""
    materials: Materials
    """RGB, specular and shininess by name, beside the robot's own."""
    build: Callable[[mujoco.MjSpec, Any, Any], None]
    """Adds bodies, sites and welds to a scene with robot, table and lights."""
    things: Mapping[str, Signal]
    """What is sensed beside the robot."""
    holds: str | None = None
    """The body that the robot may hold."""
    classes: Mapping[str, FlatClass]
    """Of flat renderings, beside ``robot``."""
    start: Callable[[Any, Chance], Start]
    """From a layout and chance: where everything begins."""
    facts: tuple[Fact, ...]
    observe: Callable[
        [Any, Any, Memory, Mapping[str, Tensor]], tuple[dict[str, Tensor], dict[str, Weld]]
    ]
    """From layout, rules, memory (after the action) and readings (after a forward): the facts
    ``(n,)`` bool by name, and welds by their name in the scene."""
    goal: str
    """The fact that says that the task is done."""
    phases: tuple[Phase, ...]
    state: tuple[str, ...]
    """Signals that ``obs=signals`` reports: enough to do the task without cameras."""
    controllers: Mapping[str, Callable[[Any, Any], Controller]]
    """Scripted controllers by name, from layout and rules. ``expert`` must be there."""
    teacher: str
    """Of the controllers, the one that is imitated."""
    human: type
    """The reward that a person wrote; values in ``conf/reward``."""
    success: Callable[[Any, Any], Tensor] | None = None
    """From rules and signals: whether an episode is successful now, ``(n,)`` bool. ``None``: where
    ``goal`` holds."""
    cheat: Callable[[Memory, Any], Tensor] | None = None
    """From memory and signals: whether an episode looks done and is not. ``None``: never."""
    cheating: str = "cheating"
    """What the controller ``cheat`` does, in a few words; not for prompts."""
    critic: Sequence[str] = ()
    """Facts that the value function reads by default."""
    telling: Telling | None = None
    """``None``: no model can be asked about it."""

    def __post_init__(self) -> None:
        names = [fact.name for fact in self.facts]
        for what, used, valid in (
            ("goal", [self.goal], names),
            ("phases", [phase.ends for phase in self.phases], names),
            ("phases", [point for phase in self.phases for point in phase.points], self.signals),
            ("state", self.state, self.signals),
            ("robot.proprio", self.robot.proprio, self.signals),
            ("critic", self.critic, self.all_facts),
            ("teacher", [self.teacher], self.controllers),
            ("controllers", ["expert"], self.controllers),
            ("telling", self.telling.moments if self.telling else (), names),
        ):
            if missing := [name for name in used if name not in valid]:
                known = ", ".join(valid)
                raise ValueError(f"task {self.name}: {what}: no {missing[0]!r} among {known}")

    @cached_property
    def signals(self) -> dict[str, Signal]:
        """The table of all signals: the task's and the robot's, ``elapsed``, facts."""
        facts = {
            one.name: Signal((), "bool", "-", "verdict" if one.verdict else "fact", one.meaning)
            for one in self.facts
        }
        used = Signal((), "1", "-", "command", "fraction of the episode's steps that is used up")
        return {**self.robot.table(self.things, self.holds), "elapsed": used, **facts}

    @cached_property
    def signals_class(self) -> type:
        """The TensorClass with a field for each signal."""
        # Slow to import.
        from tensordict import TensorClass

        fields = {"__annotations__": dict.fromkeys(self.signals, Tensor), "__module__": __name__}
        return type("Signals", (TensorClass,), fields)

    @property
    def paint(self) -> dict[str, FlatClass]:
        """Classes of flat renderings, the robot's among them."""
        return {**self.classes, "robot": FlatClass((self.robot.body,), (0, 140, 255))}

    @property
    def agent_facts(self) -> tuple[str, ...]:
        """Facts that an agent may observe: all but the verdicts."""
        return tuple(n for n, row in self.signals.items() if row.source == "fact")

    @property
    def columns(self) -> dict[str, str]:
        """The facts that a run's tables report of an episode's last step, by column."""
        cheat = {} if self.cheat is None else {"cheat": "cheat"}
        facts = {one.name: f"has_{one.name}" if one.once else one.name for one in self.facts}
        return {"success": "success", **cheat, **facts, DIVERGED: DIVERGED}

    @property
    def all_facts(self) -> tuple[str, ...]:
        """The keys of ``StepResult.facts``: of the moment, then of the episode."""
        cheat = () if self.cheat is None else ("cheat",)
        once = (f"has_{fact.name}" for fact in self.facts if fact.once)
        return (*(fact.name for fact in self.facts), "success", *cheat, *once, DIVERGED)
