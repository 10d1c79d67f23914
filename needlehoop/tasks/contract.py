"""What a task gives. All that is generic reads this and knows no task by name.

Functions are pure and batched: tensors in, tensors out, a leading dimension of ``n``
environments.
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

from needlehoop.scene.signals import Signal, signals_class
from needlehoop.scene.spec import Materials
from needlehoop.tasks.layout import Episode, Layout
from needlehoop.tasks.start import Chance, Start

Memory = Any
"""What is remembered between steps, a TensorDict of batch size ``(n,)``: the robot's targets,
``steps`` taken, facts that are remembered or were true once, and since when some are true."""

Controller = Callable[[Any], Tensor]
"""Signals to actions ``(n, action_size)``."""

DIVERGED = "diverged"
"""A fact of every task: the physics broke down."""


class Weld(NamedTuple):
    """What a weld between two bodies has to become.

    ``changed`` and ``active`` ``(n,)`` bool; ``pose`` ``(n, 7)`` of the second body in the first
    one's frame (position in m, quaternion), of use where ``active``.
    """

    changed: Tensor
    active: Tensor
    pose: Tensor


@dataclass(frozen=True)
class Fact:
    """Something that is true of a moment or not; a row of the table of signals."""

    name: str
    meaning: str
    verdict: bool = False
    """Whether it is the answer, so that reward writers may not see it."""
    remembered: bool = False
    """Whether the next ``observe`` finds its value in the memory."""
    once: bool = False
    """Whether ``has_<name>`` says that it was true at some time of the episode. A run's tables
    report that in its place."""
    timed: bool = False
    """Whether the memory has ``<name>_since``: the last step after which it was not true."""


@dataclass(frozen=True)
class Phase:
    """A part of the task, in the order in which parts follow each other."""

    name: str
    ends: str
    """The fact that ends it."""
    points: tuple[str, str]
    """Signals whose distance matters in it."""


@dataclass(frozen=True)
class FlatClass:
    """Things that a flat rendering paints in one colour."""

    bodies: tuple[str, ...]
    """Bodies whose subtrees it paints."""
    colour: tuple[int, int, int]
    """RGB, 0 to 255; a rendering may name another."""


def at_commands(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
    """Writes a start's servo commands into the joints that the servos hold, all of them."""
    columns = model.jnt_qposadr[model.actuator_trnid[:, 0]]

    def write(qpos: np.ndarray, start: Start) -> None:
        qpos[:, columns] = start.control.numpy()

    return write


class Part(NamedTuple):
    """How a body of a robot is told to a model that is to know of a camera mounted on it."""

    name: str
    """Such as ``the forearm``."""
    along: tuple[float, float, float]
    """The direction of its length towards the tip, in the body's frame; of length 1."""


@dataclass(frozen=True, kw_only=True)
class Robot:
    """Arms, and how actions move them."""

    model: Callable[[Any, str], mujoco.MjSpec]
    """From a layout and the setting ``psm``, its bodies, joints, servos and materials; the rest of
    the scene is added to them."""
    poser: Callable[[mujoco.MjModel], Callable[[np.ndarray, Start], None]] = at_commands
    """For a compiled scene, what writes a start's robot into ``qpos`` ``(k, nq)``."""
    begin: Callable[[Any, Start], dict[str, Tensor]] = lambda rules, start: {
        name: value.clone() for name, value in start.robot.items()
    }
    """From rules and a start, what the robot remembers."""
    act: Callable[[Any, Any, Memory, Tensor], tuple[dict[str, Tensor], Tensor]]
    """From layout, rules, memory and an action ``(n, action_size)``, what it remembers now, and
    the servos' commands ``(n, nu)``."""
    table: Callable[[Mapping[str, Signal], str | None], Mapping[str, Signal]]
    """From what a task senses, and the body that the robot may hold, a table with what the robot
    senses, its touches of that body and its commands."""
    commands: Mapping[str, str]
    """Signals that come from the memory and not from sensors, and their names there."""
    body: str
    """Root of its bodies: class ``robot`` of flat renderings."""
    proprio: tuple[str, ...]
    """Signals that it knows of itself."""
    displaced: Callable[[Any, Any, Memory, Tensor, Tensor], Tensor] | None = None
    """From layout, rules, memory, the servos' commands and an offset ``(n, 3)`` in m, commands
    that put the tip so far beside where it was told to. ``None``: it cannot be disturbed so."""
    parts: Mapping[str, Part] = field(default_factory=dict)
    """How bodies that a camera may well be mounted on are told to a model, by body."""
    opens: int | None = None
    """Number of the action that lets go of what is held where it is 1. Actions of 0 hold still.
    ``None``: nothing is ever held."""


@dataclass(frozen=True)
class Telling:
    """How a task is told to a vision-language model.

    The general prompts are in ``needlehoop/vlm/prompts``; they take these texts and words in.
    Nothing here may tell the human reward, or the limits by which success is decided.
    """

    texts: Path
    """Folder of texts with ``$gaps``. ``scene.txt``: what there is, and what the task is.
    ``signals.txt``: the numbers behind the signals, a line ``- …`` each. ``<fact>.txt``, for some
    of ``moments``: the question which camera shows the fact best."""
    values: Callable[[Any, Any], Mapping[str, object]]
    """From layout and rules, what fills the gaps, by name; and ``control``: what an agent does at
    every step, such as ``moves the tip by up to 6 mm``."""
    goal: str
    """What is so in the picture of the goal, such as ``the cube is on the spot``."""
    done: str
    """The same without the test of success, for reward writers: ``the cube is where it has to
    be``."""
    front: str
    """What the views at azimuth 0 are in front of, such as ``the spot``."""
    moments: Mapping[str, str] = field(default_factory=dict)
    """Facts whose first moments are pictured, in order, and what is so then, such as ``the cube
    has just been grasped``. Start and goal are pictured as well."""
    painted: Mapping[str, str] = field(default_factory=dict)
    """What has to be said of a class of flat renderings, by class."""


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
    """From a layout and chance, where everything begins."""
    facts: tuple[Fact, ...]
    """In the order in which they are reported."""
    observe: Callable[
        [Any, Any, Memory, Mapping[str, Tensor]], tuple[dict[str, Tensor], dict[str, Weld]]
    ]
    """From layout, rules, memory (after the action) and readings (after a forward), the facts
    ``(n,)`` bool by name, and what welds have to become, by their name in the scene."""
    goal: str
    """The fact that says that the task is done."""
    phases: tuple[Phase, ...]
    state: tuple[str, ...]
    """Signals that ``obs=signals`` reports: enough to do the task without eyes."""
    controllers: Mapping[str, Callable[[Any, Any], Controller]]
    """Scripted controllers by name, from layout and rules. ``expert`` must be there."""
    teacher: str
    """Of the controllers, the one that is imitated."""
    human: type
    """The reward that a person wrote; values in ``conf/reward``."""
    success: Callable[[Any, Any], Tensor] | None = None
    """From rules and signals, whether an episode is successful now, ``(n,)`` bool; ``None``: where
    ``goal`` holds."""
    cheat: Callable[[Memory, Any], Tensor] | None = None
    """From memory and signals, whether an episode looks done and is not; ``None``: never."""
    cheating: str = "cheating"
    """What the controller ``cheat`` does, in a few words. Models are not told."""
    critic: Sequence[str] = ()
    """Facts that the value function is told by default."""
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
        """The table of all signals: readings of sensors, the robot's commands, ``elapsed``, facts.

        Its sensors are those of the scene.
        """
        facts = {
            one.name: Signal((), "bool", "-", "verdict" if one.verdict else "fact", one.meaning)
            for one in self.facts
        }
        used = Signal((), "1", "-", "command", "fraction of the episode's steps that is used up")
        return {**self.robot.table(self.things, self.holds), "elapsed": used, **facts}

    @cached_property
    def signals_class(self) -> type:
        """The TensorClass of its signals."""
        return signals_class(self.signals)

    @property
    def paint(self) -> dict[str, FlatClass]:
        """Classes of flat renderings, the robot's among them."""
        return {**self.classes, "robot": FlatClass((self.robot.body,), (0, 140, 255))}

    @property
    def told(self) -> tuple[str, ...]:
        """Facts that a robot can keep track of by itself; a verdict would be the answer."""
        return tuple(n for n, row in self.signals.items() if row.source == "fact")

    @property
    def columns(self) -> dict[str, str]:
        """What a run's tables report of an episode's last step: the fact by the column's name."""
        cheat = {} if self.cheat is None else {"cheat": "cheat"}
        own = {one.name: f"has_{one.name}" if one.once else one.name for one in self.facts}
        return {"success": "success", **cheat, **own, DIVERGED: DIVERGED}

    @property
    def all_facts(self) -> tuple[str, ...]:
        """Of the moment, then of the episode: the keys of ``facts`` in every environment."""
        cheat = () if self.cheat is None else ("cheat",)
        once = (f"has_{fact.name}" for fact in self.facts if fact.once)
        return (*(fact.name for fact in self.facts), "success", *cheat, *once, DIVERGED)
