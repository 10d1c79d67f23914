"""The task as a Gymnasium vector environment, on the batched engine."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Moment, Simulation
from needlehoop.gym.stage import Stage, check_options, info, masked

_MODES = ("rgb_array",)

Observation = dict[str, np.ndarray]


class GymnasiumVectorEnv(VectorEnv):
    """``num_envs`` environments in one process and one engine, stepped together.

    Observations, actions and ``info`` are those of ``GymnasiumEnv`` with a dimension ``n`` in
    front; ``infos`` has Gymnasium's ``_<name>`` masks. ``reset(seed=s)`` begins the first
    episodes of the seed's environments 0 to ``n - 1``: those of ``TorchRLEnv`` with that
    seed, and in environment 0 that of ``GymnasiumEnv``.

    What happens to an environment whose episode is over is Gymnasium's ``AutoresetMode``:

    - ``NEXT_STEP``: its next step begins an episode; that action is ignored, the reward is 0.
    - ``SAME_STEP``: the same step does; ``infos["final_obs"]`` (an array of observations or
      ``None``) and ``infos["final_info"]`` have what the episode ended with.
    - ``DISABLED``: ``reset(options={"reset_mask": mask})`` does, and must, before the next step.

    A reset with a mask returns the observations of all and the infos of those in the mask.

    Args:
        settings: what to build; ``seed`` is ignored.
        channels: of images: ``last`` or ``first``.
        render_mode: ``rgb_array`` or ``None``.
        render_size: height and width of what ``render`` returns, px.
        autoreset_mode: as above, or its value: ``NextStep``, ``SameStep``, ``Disabled``.

    Raises:
        ValueError: settings that do not go together, by key.
    """

    def __init__(
        self,
        settings: Settings,
        channels: str = "last",
        render_mode: str | None = None,
        render_size: int = 480,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ):
        self.settings, self.render_mode, self.num_envs = settings, render_mode, settings.num_envs
        self.autoreset_mode = _autoreset(autoreset_mode)
        self.metadata = {
            "render_modes": [*_MODES],
            "render_fps": 1.0 / settings.period,
            "autoreset_mode": self.autoreset_mode,
        }
        self._stage = Stage(settings, channels, render_mode, _MODES, render_size)
        self.single_observation_space = self._stage.observation_space
        self.single_action_space = self._stage.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)

    @property
    def simulation(self) -> Simulation:
        """The simulation inside: signals, state, engine."""
        return self._stage.simulation

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes: everywhere, or where ``options["reset_mask"]`` ``(n,)`` is true.

        Raises:
            Error: an unknown option.
            ValueError: a mask that is none, or one with a seed: a seed is of all environments.
            ResetNeeded: a mask before the first reset.
        """
        mask = self._mask(options)
        if mask is None:
            return self._reset_all(seed)
        if seed is not None:
            raise ValueError("seed: it is of all environments; give it without a reset_mask")
        self._check_begun()
        moment = self._stage.reset(mask=mask)
        self._over &= ~mask
        return self._stage.look(moment, _ids(mask)), masked(info(moment), mask)

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control step of every environment; rewards float64, all ``(n,)``.

        Raises:
            ResetNeeded: before the first reset, or an episode is over and the mode is
                ``DISABLED``.
            InvalidAction: not ``(n, action_size)`` real numbers.
            ValueError: a number that is not finite.
        """
        self._check_begun()
        actions = self._stage.numbers(actions, self.num_envs)
        before = self._over
        if self.autoreset_mode == AutoresetMode.DISABLED and before.any():
            raise ResetNeeded(
                f"environments {before.nonzero()[0].tolist()} are over; reset them with"
                " options={'reset_mask': mask}"
            )
        renewed = before if self.autoreset_mode == AutoresetMode.NEXT_STEP else before & False
        if renewed.any():
            actions = np.where(renewed[:, None], 0.0, actions)
        moment = self._stage.step(actions)
        # What the step paid and ended; zero where an episode begins in it.
        rewards, terminated, truncated = (
            np.where(renewed, np.zeros_like(value), value)
            for value in (t.numpy() for t in (moment.reward, moment.terminated, moment.truncated))
        )
        if renewed.any():
            moment = self._stage.reset(mask=renewed)
        self._over = terminated | truncated
        seen, infos = self._finish(moment)
        return seen, rewards, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """The scene in each environment ``(size, size, 3)`` uint8."""
        pictures = (self._stage.picture(env) for env in range(self.num_envs))
        return tuple(one for one in pictures if one is not None) or None

    def _reset_all(self, seed: int | None) -> tuple[Observation, dict[str, Any]]:
        if seed is not None and not isinstance(seed, int | np.integer):
            raise ValueError(f"seed: {seed!r} is not a whole number; one is for all environments")
        super().reset(seed=seed)
        if seed is None and self.simulation.state is None:
            seed = self.np_random_seed
        moment = self._stage.reset(seed)
        self._over[:] = False
        return self._stage.look(moment), self._infos(moment)

    def _finish(self, moment: Moment) -> tuple[Observation, dict[str, Any]]:
        """Observations and infos after a step; in ``SAME_STEP`` of the episodes that begin."""
        seen, over = self._stage.look(moment), self._over
        if self.autoreset_mode != AutoresetMode.SAME_STEP or not over.any():
            return seen, self._infos(moment)
        final = np.full(self.num_envs, None, dtype=object)
        for env in over.nonzero()[0]:
            final[env] = {name: value[env].copy() for name, value in seen.items()}
        ended = {
            "final_obs": final,
            "_final_obs": over.copy(),
            "final_info": masked(info(moment), over),
            "_final_info": over.copy(),
        }
        moment = self._stage.reset(mask=over)
        return self._stage.look(moment, _ids(over)), {**ended, **self._infos(moment)}

    def _infos(self, moment: Moment) -> dict[str, Any]:
        return masked(info(moment), np.ones(self.num_envs, dtype=np.bool_))

    def _check_begun(self) -> None:
        if self.simulation.state is None:
            raise ResetNeeded("reset all environments first")

    def _mask(self, options: dict[str, Any] | None) -> np.ndarray | None:
        check_options(options, ("reset_mask",))
        if not options:
            return None
        mask = np.asarray(options["reset_mask"])
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"reset_mask: {mask.dtype} {mask.shape}; give booleans ({self.num_envs},) of"
                " which at least one is true"
            )
        return mask


def _ids(mask: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(mask.nonzero()[0])


def _autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        valid = ", ".join(one.value for one in AutoresetMode)
        raise ValueError(f"autoreset_mode: {mode!r} is unknown; choose from {valid}") from error
