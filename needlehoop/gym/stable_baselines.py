"""The batched engine as Stable-Baselines3's VecEnv. Extra ``sb3``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import StepResult
from needlehoop.gym.vector import GymnasiumVectorEnv, Observation, checked, info, row

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
except ImportError as error:
    raise ImportError(
        f"make_sb3 needs stable-baselines3 ({error});"
        " install it with: pip install 'needlehoop[sb3]'"
    ) from error


class StableBaselinesVecEnv(VecEnv):
    """``num_envs`` environments for an algorithm of Stable-Baselines3.

    Observations and actions are those of ``GymnasiumVectorEnv``, images channels first, as
    torch takes them. An episode that is over begins anew in the same step. Its last info
    has ``terminal_observation`` and ``TimeLimit.truncated``; every info has ``is_success``,
    which SB3 logs as ``rollout/success_rate`` under a ``VecMonitor``, and what
    ``GymnasiumEnv`` tells.

    Episodes are those of ``TorchRLEnv`` with the same seed: that of the settings until
    ``seed`` is called, as SB3 does where ``seed=`` is given to the algorithm.
    """

    def __init__(self, settings: Settings, render_mode: str | None = None):
        self.env = GymnasiumVectorEnv(settings, "first", render_mode)
        spaces = self.env.single_observation_space, self.env.single_action_space
        super().__init__(settings.num_envs, *spaces)
        self._seeds[0] = settings.seed
        self._actions: np.ndarray | None = None

    def reset(self) -> Observation:
        """Begin an episode everywhere."""
        moment = self.env.begin(self._seeds[0])
        self.reset_infos = self._rows(moment)
        self._reset_seeds()
        return self.env.look(moment)

    def step_async(self, actions: np.ndarray) -> None:
        """Note the actions ``(n, action_size)`` of the step."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take it: observations, rewards float32 ``(n,)``, dones ``(n,)``, an info for each."""
        env = self.env
        env.check_begun()
        moment = env.advance(checked(self._actions, env.action_space))
        rewards, rows, seen = (
            moment.reward.float().cpu().numpy(),
            self._rows(moment),
            env.look(moment),
        )
        dones = (moment.terminated | moment.truncated).cpu().numpy()
        if dones.any():
            fresh = env.begin(mask=dones)
            begun = self._rows(fresh)
            for i in dones.nonzero()[0]:
                self.reset_infos[i] = begun[i]
                rows[i]["terminal_observation"] = {name: value[i] for name, value in seen.items()}
                rows[i]["TimeLimit.truncated"] = not bool(moment.terminated[i])
            seen = env.look(fresh, dones)
        return seen, rewards, dones, rows

    def close(self) -> None:
        """Nothing is left open."""

    def get_images(self) -> Sequence[np.ndarray | None]:
        """The scene in each environment ``(size, size, 3)`` uint8."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the vector environment, once for each of ``indices``."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        raise NotImplementedError("environments in one batch share their attributes")

    def env_method(self, method_name: str, *args: Any, **kwargs: Any) -> list[Any]:
        raise NotImplementedError("environments in one batch have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))

    def _rows(self, moment: StepResult) -> list[dict[str, Any]]:
        """What is known beside the observations, one environment after the other."""
        known = info(moment)
        rows = [row(known, env) for env in range(self.num_envs)]
        return [{**one, "is_success": one["success"]} for one in rows]
