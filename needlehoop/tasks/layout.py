"""Sizes, placement and rules that every task has, and those of tasks with the PSM."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, get_type_hints

import numpy as np
from torch import Tensor

from needlehoop.config.strict import OneOf, Range, check_names

GRASPS = ("weld", "friction")
"""What holds a thing in the jaws."""

Length = Annotated[float, Range(1e-5, 1.0)]
"""m; MuJoCo makes no shapes of far smaller sizes."""

Place = Annotated[float, Range(-1.0, 1.0)]
"""A coordinate, m."""

Spread = Annotated[float, Range(0.0, 2 * math.pi)]
"""A half-width, m or rad."""

Turn = Annotated[float, Range(-2 * math.pi, 2 * math.pi)]
"""rad."""


@dataclass(frozen=True)
class Layout:
    """Sizes and placement of a task; values in ``conf/task``.

    Lengths in m, angles in rad, positions in the world frame. Ranges are half-widths of uniform
    distributions about the nominal value.
    """

    name: str
    """Of the task."""
    timestep: Annotated[float, Range(1e-4, 0.01)]
    """Physics step, s."""


@dataclass(frozen=True)
class Tool:
    """Where a robot's tool begins and may go; see ``Layout``."""

    tool_position: tuple[Place, Place, Place]
    """Nominal start of the tool."""
    tool_position_range: tuple[Spread, Spread, Spread]
    workspace_lower: tuple[Place, Place, Place]
    workspace_upper: tuple[Place, Place, Place]
    """Corners of the box that clamps the tool's target."""

    def __post_init__(self) -> None:
        lower, upper = self.workspace_lower, self.workspace_upper
        if not all(a < b for a, b in zip(lower, upper, strict=True)):
            raise ValueError(f"task.workspace_lower: {lower} must be below {upper}")

    def clamp(self, place: Tensor) -> Tensor:
        """Places ``(n, 3)``, m, brought into the workspace."""
        return place.clamp(*place.new_tensor((self.workspace_lower, self.workspace_upper)))


@dataclass(frozen=True)
class ToolLayout(Tool, Layout):
    """The layout of a task with one tool."""


@dataclass(frozen=True)
class Arm(Tool):
    """Where a PSM stands, begins and may go; its tool is ``tool_midpoint``."""

    tool_roll: Turn
    """Start of the rotation about the instrument's axis."""
    tool_jaw: Turn
    """Start of the jaw angle."""

    roll_range: Spread
    """The rotation's target stays within this of ``tool_roll``."""
    jaw_closed: Turn
    jaw_open: Turn
    """Limits of the jaw command."""

    rcm_height: Length
    """Height of the remote centre of motion above the table."""
    grip: Length
    """Distance of ``tool_midpoint`` from the wrist-yaw axis, along the blades."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.jaw_closed < self.jaw_open:
            raise ValueError(f"task.jaw_closed: {self.jaw_closed} must be below {self.jaw_open}")

    @property
    def rcm(self) -> np.ndarray:
        """Position of the remote centre of motion, ``(3,)``."""
        return np.array([0.0, 0.0, self.rcm_height])

    @property
    def tilt(self) -> float:
        """Turn of the remote centre's frame about the world's y."""
        return 0.0


@dataclass(frozen=True)
class ArmLayout(Arm, ToolLayout):
    """The layout of a task with one PSM, which stands upright above the origin."""


@dataclass(frozen=True)
class ArmAside(Arm):
    """One of several PSMs: it stands aside, and leans."""

    rcm_x: Place
    rcm_tilt: Turn
    """See ``tilt``."""

    @property
    def rcm(self) -> np.ndarray:
        return np.array([self.rcm_x, 0.0, self.rcm_height])

    @property
    def tilt(self) -> float:
        return self.rcm_tilt


@dataclass(frozen=True)
class Episode:
    """Control and termination; values in ``conf/episode``."""

    CONTROLS: ClassVar[dict[str, int]] = {}
    """Length of the action by control mode."""

    control: str
    """One of ``CONTROLS``."""
    substeps: Annotated[int, Range(1, 1000)]
    """Physics steps per action."""
    max_steps: Annotated[int, Range(1, 1_000_000)]
    """Actions after which an episode is truncated."""
    end_on_success: bool
    """Whether success terminates the episode."""

    def __post_init__(self) -> None:
        check_names("episode.control", [self.control], tuple(self.CONTROLS))

    @property
    def action_size(self) -> int:
        """Numbers in an action."""
        return self.CONTROLS[self.control]


@dataclass(frozen=True)
class ToolEpisode(Episode):
    """How actions move the PSM. Lengths in m, angles in rad.

    ``control=tip``: tip x, y, z, rotation about the instrument, jaw. ``pose``: tip x, y, z,
    rotation vector in the remote centre's frame, jaw.
    """

    CONTROLS: ClassVar[dict[str, int]] = {"tip": 5, "pose": 7}

    translation: Annotated[float, Range(0.0, 1.0, above=True)]
    """Largest move of the tip's target per action and axis."""
    rotation: Annotated[float, Range(0.0, 7.0, above=True)]
    """Largest turn of the target per action."""
    jaw: Annotated[float, Range(0.0, 7.0, above=True)]
    """Largest change of the jaw command per action."""


@dataclass(frozen=True)
class ArmEpisode(ToolEpisode):
    """How actions move the PSM, and when its jaws hold something."""

    grasp: Annotated[str, OneOf(*GRASPS)]
    """What holds a thing once the jaws have grasped it. ``weld``: it is fixed to the wrist.
    ``friction``: contacts alone hold it. A grasp begins in the same way with both."""
    close_below: Annotated[float, Range(-7.0, 7.0)]
    """A grasp needs a jaw command below this."""
    release_above: Annotated[float, Range(-7.0, 7.0)]
    """A jaw command above this lets go."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.close_below < self.release_above:
            raise ValueError(
                f"episode.close_below: {self.close_below} must be below"
                f" release_above={self.release_above}"
            )


def lengths(layout: Layout | Tool) -> dict[str, str]:
    """Fields that are a ``Length``, by name, in mm, for prompts."""
    hints = get_type_hints(type(layout), include_extras=True)
    return {
        name: millimetres(getattr(layout, name)) for name, hint in hints.items() if hint == Length
    }


def millimetres(metres: float) -> str:
    """A length in mm, to a tenth."""
    return f"{1000 * metres:.1f}".removesuffix(".0")
