"""Stable-Baselines3's PPO on the dm_control environment: needs ``needlehoop[bench]``."""

from __future__ import annotations

from functools import partial
from typing import Any

# Extras of the benchmark: not in the environment in which the checks run.
import gymnasium  # pyright: ignore[reportMissingImports]
import numpy as np
import torch
from stable_baselines3 import PPO  # pyright: ignore
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor  # pyright: ignore
from stable_baselines3.common.vec_env import DummyVecEnv  # pyright: ignore
from torch import Tensor, nn

from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import Encoder, Fold
from needlehoop.learning.job import Job
from needlehoop.learning.precision import convolution_dtype
from needlehoop.pictures.opengl import OpenGLEnvironment


class GymEnvironment(gymnasium.Env):
    """The dm_control environment, seen by MuJoCo's renderer, as a gymnasium one.

    Args:
        settings: environment with its cameras.
        env: which of the seed's environments.
    """

    def __init__(self, settings: Settings, env: int):
        self._environment = OpenGLEnvironment(settings, env)
        size = settings.image_size
        self.observation_space = gymnasium.spaces.Dict(
            {
                camera.name: gymnasium.spaces.Box(
                    0, 255, (settings.renderings[camera.rendering].channels, size, size), np.uint8
                )
                for camera in settings.cameras
            }
        )
        shape = (settings.episode.action_size,)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self._environment.reset(), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        images, moment = self._environment.step(action)
        over = moment.last()
        terminated = over and moment.discount == 0.0
        return images, float(moment.reward), terminated, over and not terminated, {}


class Encoders(BaseFeaturesExtractor):
    """Our encoders, one per camera, side by side."""

    def __init__(self, observation_space: gymnasium.spaces.Dict, job: Job, dtype: torch.dtype):
        out = job.algo.network.hidden
        super().__init__(observation_space, out * len(observation_space.spaces))
        self._fold = Fold(job.encoder.stem)
        self.encoders = nn.ModuleDict(
            {
                name: Encoder(torch.Size(space.shape or ()), job.encoder, out, dtype)
                for name, space in observation_space.spaces.items()
            }
        )

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        parts = [encoder(self._fold(observations[name])) for name, encoder in self.encoders.items()]
        return torch.cat(parts, -1)


def build_sb3(job: Job, num_envs: int, steps: int) -> PPO:
    """SB3's PPO with a job's hyperparameters and network sizes.

    Args:
        job: cameras, encoder, hyperparameters.
        num_envs: dm_control environments, stepped one after the other.
        steps: of each environment per buffer.
    """
    dtype = convolution_dtype(job.precision, job.torch_device)
    layers = [job.algo.network.hidden] * job.algo.network.layers
    makers: list[Any] = [partial(GymEnvironment, job.env, env) for env in range(num_envs)]
    return PPO(
        "MultiInputPolicy",
        DummyVecEnv(makers),
        n_steps=steps,
        batch_size=min(job.algo.minibatch, num_envs * steps),
        n_epochs=job.algo.epochs,
        learning_rate=job.algo.learning_rate,
        gamma=job.algo.gamma,
        gae_lambda=job.algo.lam,
        clip_range=job.algo.epsilon,
        ent_coef=job.algo.beta,
        seed=job.env.seed,
        device=job.torch_device,
        policy_kwargs={
            "features_extractor_class": Encoders,
            "features_extractor_kwargs": {"job": job, "dtype": dtype},
            # Images stay uint8: the encoder scales them itself.
            "normalize_images": False,
            "net_arch": layers,
            "activation_fn": nn.SiLU,
            # Theirs fails on convolutions whose weights are channels last.
            "ortho_init": False,
        },
    )
