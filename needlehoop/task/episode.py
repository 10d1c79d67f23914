"""An episode's settings: control, grasp, what ends it, and when a fact holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from needlehoop.config.strict import Range

CONTROLS = {"tip": 5, "pose": 7}
"""Length of the action by control mode."""
GRASPS = ("weld", "friction")
SUCCESSES = ("thread", "touch")


@dataclass(frozen=True)
class Episode:
    """Control and termination; values in ``conf/episode``. Lengths in m, angles in rad."""

    control: str
    """``tip``: tip x, y, z, rotation about the instrument, jaw. ``pose``: tip x, y, z,
    rotation vector in the world frame, jaw."""
    grasp: str
    """``weld``: jaws that touch the needle and close hold it rigidly. ``friction``: contacts
    alone hold it, so a grasp needs the needle between the blades as well."""
    substeps: Annotated[int, Range(1, 1000)]
    """Physics steps per action."""
    max_steps: Annotated[int, Range(1, 1_000_000)]
    """Actions after which an episode is truncated."""
    end_on_success: bool
    """Whether success terminates the episode."""
    translation: Annotated[float, Range(0.0, 1.0, above=True)]
    """Largest move of the tip's target per action and axis."""
    rotation: Annotated[float, Range(0.0, 7.0, above=True)]
    """Largest turn of the target per action."""
    jaw: Annotated[float, Range(0.0, 7.0, above=True)]
    """Largest change of the jaw command per action."""
    close_below: Annotated[float, Range(-7.0, 7.0)]
    """A grasp needs a jaw command below this."""
    release_above: Annotated[float, Range(-7.0, 7.0)]
    """A jaw command above this lets go."""
    lift_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``lifted``: the pickup point came this near the lift position."""
    goal_radius: Annotated[float, Range(0.0, 1.0, above=True)]
    """``touched``: the tip is this near the goal."""
    thread_depth: Annotated[float, Range(-1.0, 1.0)]
    """``threaded``: the tip is at least this far beyond the hoop's plane."""
    success: str = SUCCESSES[0]
    """``thread``: the needle is through the hoop. ``touch``: its tip is at the goal, as in the
    paper."""

    def __post_init__(self) -> None:
        for key, value, valid in (
            ("control", self.control, tuple(CONTROLS)),
            ("grasp", self.grasp, GRASPS),
            ("success", self.success, SUCCESSES),
        ):
            if value not in valid:
                raise ValueError(
                    f"episode.{key}: {value!r} is unknown; choose from {', '.join(valid)}"
                )
        if not self.close_below < self.release_above:
            raise ValueError(
                f"episode.close_below: {self.close_below} must be below"
                f" release_above={self.release_above}"
            )

    @property
    def action_size(self) -> int:
        """Numbers in an action."""
        return CONTROLS[self.control]
