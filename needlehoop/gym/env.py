"""The task as a Gymnasium environment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from needlehoop.config.strict import check_names
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import StepResult
from needlehoop.gym.vector import (
    GymnasiumVectorEnv,
    Observation,
    check_options,
    info,
    real_numbers,
    row,
)
from needlehoop.pictures.window import Window, check_display, has_display

MODES = ("human", "rgb_array")
METADATA: dict[str, Any] = {"render_modes": [*MODES], "render_fps": 25}
"""Frames per second are those of the default control step, 40 ms; an environment's own count."""


class GymnasiumEnv(gymnasium.Env):
    """One environment; observations are a ``Dict``.

    By camera: uint8 ``(h, w, frame_stack * channels)``, or channels first; ``proprio`` float32
    ``(8,)``, ``signals`` float32 ``(29,)`` and ``told`` where asked for. Actions:
    ``Box(-1, 1)``, five numbers (seven with ``control=pose``). ``info``: ``facts`` and
    ``terms`` by name, ``success`` (what ``episode.success`` says it is), ``cheat``,
    ``potential``, ``steps``. Success terminates; the time limit truncates.

    ``reset(seed=s)`` begins the first episode of environment 0 of the seed ``s``, which is that
    of ``needlehoop.load(seed=s)``; ``reset()`` begins the next. If no seed is ever given, one
    comes from the operating system; ``np_random_seed`` tells it.

    Args:
        settings: what to build; ``num_envs`` and ``seed`` are ignored.
        channels: of images: ``last`` or ``first``.
        render_mode: ``rgb_array`` (the scene for people), ``human`` (a window), or ``None``.
        render_size: height and width of what ``render`` returns, px.

    Raises:
        ValueError: settings that do not go together, by key.
        RuntimeError: ``human`` without a display.
    """

    metadata = METADATA

    def __init__(
        self,
        settings: Settings,
        channels: str = "last",
        render_mode: str | None = None,
        render_size: int = 480,
    ):
        check_names("render_mode", [render_mode] if render_mode is not None else [], MODES)
        self.settings, self.render_mode = replace(settings, num_envs=1), render_mode
        picture = "rgb_array" if render_mode == "rgb_array" else None
        self._alone = GymnasiumVectorEnv(self.settings, channels, picture, render_size)
        self.simulation = self._alone.simulation
        """The simulation inside: signals, state, engine."""
        self._window = None
        if render_mode == "human":
            check_display("render_mode=rgb_array gives pictures")
            self._window = Window(self.simulation)
        self.observation_space = self._alone.single_observation_space
        self.action_space = self._alone.single_action_space
        # METADATA has every mode; this has those that work on this machine.
        modes = [mode for mode in MODES if mode != "human" or has_display()]
        self.metadata = {"render_modes": modes, "render_fps": 1.0 / settings.period}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Raises:
            Error: options, of which there are none, or a seed that is no whole number from 0 on.
        """
        check_options(options)
        super().reset(seed=seed)
        if seed is None and self.simulation.state is None:
            seed = self.np_random_seed
        return self._seen(self._alone.begin(seed))

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step.

        Raises:
            ResetNeeded: before the first reset.
            InvalidAction: not ``(action_size,)`` real numbers.
            ValueError: a number that is not finite.
        """
        self._alone.check_begun()
        moment = self._alone.advance(real_numbers(action, self.action_space)[None])
        seen, known = self._seen(moment)
        ends = bool(moment.terminated[0]), bool(moment.truncated[0])
        return seen, float(moment.reward[0]), *ends, known

    def render(self) -> np.ndarray | None:
        """The scene ``(size, size, 3)`` uint8; nothing in the mode ``human``."""
        pictures = self._alone.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _seen(self, moment: StepResult) -> tuple[Observation, dict[str, Any]]:
        if self._window is not None:
            self._window.show()
        seen = {name: value[0] for name, value in self._alone.look(moment).items()}
        return seen, row(info(moment), 0)
