"""The task as a Gymnasium environment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from needlehoop.config.strict import check_names
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import StepResult
from needlehoop.gym.vector import MODES, GymnasiumVectorEnv, Observation, checked, info, row

METADATA: dict[str, Any] = {"render_modes": [*MODES], "render_fps": 25}
"""25 frames a second: the default control step is 40 ms."""


class GymnasiumEnv(gymnasium.Env):
    """One environment; observations are a ``Dict``.

    By camera: uint8 ``(h, w, frame_stack * channels)``, or channels first; ``proprio`` float32
    ``(8,)``, ``signals`` float32 ``(29,)`` and ``privileged_facts`` where asked for. Actions:
    ``Box(-1, 1)``, five numbers (seven with ``control=pose``). ``info``: ``facts`` and
    ``terms`` by name, ``success`` (what ``episode.success`` says it is), ``cheat``,
    ``potential``, ``steps``. Success terminates; the time limit truncates.

    ``reset(seed=s)`` begins the first episode of environment 0 of the seed ``s``, which is that
    of ``needlehoop.load(seed=s)``; ``reset()`` begins the next. If no seed is ever given, one
    comes from the operating system; ``np_random_seed`` tells it. Arguments and errors are those
    of ``GymnasiumVectorEnv``; ``num_envs`` of the settings is ignored too.
    """

    metadata = METADATA

    def __init__(
        self,
        settings: Settings,
        channels: str = "last",
        render_mode: str | None = None,
        render_size: int = 480,
    ):
        self.settings, self.render_mode = replace(settings, num_envs=1), render_mode
        self._alone = GymnasiumVectorEnv(self.settings, channels, render_mode, render_size)
        self.simulation = self._alone.simulation
        """The simulation inside: signals, state, engine."""
        self.observation_space = self._alone.single_observation_space
        self.action_space = self._alone.single_action_space
        self.metadata = {**METADATA, "render_fps": 1.0 / settings.period}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; ``ValueError`` for options, because there are none."""
        check_names("options", [*(options or ())], ())
        super().reset(seed=seed)
        if seed is None and self.simulation.state is None:
            seed = self.np_random_seed
        return self._seen(self._alone.begin(seed))

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step; errors are as in ``GymnasiumVectorEnv.step``."""
        self._alone.check_begun()
        moment = self._alone.advance(checked(action, self.action_space)[None])
        ends = bool(moment.terminated[0]), bool(moment.truncated[0])
        seen, known = self._seen(moment)
        return seen, float(moment.reward[0]), *ends, known

    def render(self) -> np.ndarray | None:
        """The scene ``(size, size, 3)`` uint8."""
        pictures = self._alone.render()
        return None if pictures is None else pictures[0]

    def _seen(self, moment: StepResult) -> tuple[Observation, dict[str, Any]]:
        seen = {name: value[0] for name, value in self._alone.look(moment).items()}
        return seen, row(info(moment), 0)
