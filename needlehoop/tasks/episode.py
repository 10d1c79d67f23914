"""Settings of an episode: what every task has, and what tasks with the PSM have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from needlehoop.config.strict import Range, check_names

GRASPS = ("weld", "friction")


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
    rotation vector in the world frame, jaw.
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

    grasp: str
    """``weld``: jaws that touch the thing and close hold it rigidly. ``friction``: contacts
    alone hold it, so a grasp needs the thing between the blades as well."""
    close_below: Annotated[float, Range(-7.0, 7.0)]
    """A grasp needs a jaw command below this."""
    release_above: Annotated[float, Range(-7.0, 7.0)]
    """A jaw command above this lets go."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names("episode.grasp", [self.grasp], GRASPS)
        if not self.close_below < self.release_above:
            raise ValueError(
                f"episode.close_below: {self.close_below} must be below"
                f" release_above={self.release_above}"
            )
