"""Stable-Baselines3's PPO on our environments, and on dm_control's with MuJoCo's default renderer.

    python benchmarks/others.py rounds=3 cams=[dep_front]

The words are settings of ``needlehoop bench train``. Both learn with the same hyperparameters and
encoders, in turns in one process; the first round of each warms up and is not counted. Beside them
stands the speed of the second one's environment alone. Extra ``sb3``, and an OpenGL library.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from statistics import harmonic_mean
from typing import Any

# dm_control picks its OpenGL library when it is imported; without a display it picks one that
# needs a display.
os.environ.setdefault("MUJOCO_GL", "egl")

import gymnasium
import mujoco
import numpy as np
import torch
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch import Tensor, nn

from needlehoop.bench.speed import about, rounds_of
from needlehoop.config import composing, strict
from needlehoop.config.strict import Count
from needlehoop.engines.contract import Frame
from needlehoop.engines.dm_control import DmControlEngine
from needlehoop.envs.images import channels_of
from needlehoop.envs.settings import Settings
from needlehoop.gym.env import GymnasiumEnv
from needlehoop.gym.stable_baselines import StableBaselinesVecEnv
from needlehoop.learning.encoder import Encoder, Fold, convolution_dtype
from needlehoop.learning.job import Job, typed_job
from needlehoop.runs.machine import available_cpus

DM_CONTROL_ENVS = 8
"""The paper's number of environments."""

STEPS = 32
"""Of each environment per round; times the above, one minibatch."""


class OpenGL:
    """MuJoCo's default renderer, in the place of an engine's own."""

    def __init__(self, engine: DmControlEngine, settings: Settings):
        self._physics, self._size = engine.physics[0], settings.image_size
        self._asked = channels_of(settings)

    def render(self, fields: Mapping[str, np.ndarray], ids: Any = None) -> dict[str, Frame]:
        """Frames of the one environment by view."""
        frames = {}
        for view, asked in self._asked.items():
            bgra = depth = geom = None
            if asked.colour:
                colour = self._look(view)
                alpha = np.full_like(colour[..., :1], 255)
                bgra = torch.from_numpy(np.concatenate((colour[..., ::-1], alpha), -1)[None])
            if asked.depth:
                depth = torch.from_numpy(self._look(view, depth=True).copy()[None])
            if asked.geom:
                # Pairs of object id and object type.
                found = self._look(view, segmentation=True)
                is_geom = found[..., 1] == mujoco.mjtObj.mjOBJ_GEOM
                geom = torch.from_numpy(np.where(is_geom, found[..., 0], -1).astype(np.int32)[None])
            frames[view] = Frame(bgra, depth, geom)
        return frames

    def _look(self, view: str, **kind: bool) -> np.ndarray:
        return self._physics.render(self._size, self._size, camera_id=view, **kind)


def opengl_env(settings: Settings) -> gymnasium.Env:
    """An environment on dm_control's physics, seen by MuJoCo's renderer."""
    engine = replace(settings.engine, kind="dm_control")
    env = GymnasiumEnv(replace(settings, engine=engine), channels="first")
    inside = env.simulation.engine
    assert isinstance(inside, DmControlEngine)
    inside.renderer = OpenGL(inside, settings)
    return env


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


def ppo(job: Job, env: VecEnv) -> PPO:
    """SB3's PPO with a job's hyperparameters and network sizes."""
    dtype = convolution_dtype(job.precision, job.torch_device)
    return PPO(
        "MultiInputPolicy",
        env,
        n_steps=STEPS,
        batch_size=min(job.algo.minibatch, env.num_envs * STEPS),
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
            "net_arch": [job.algo.network.hidden] * job.algo.network.layers,
            "activation_fn": nn.SiLU,
            # Theirs fails on convolutions whose weights are channels last.
            "ortho_init": False,
        },
    )


def learning_rate(model: PPO) -> float:
    """Environment steps per second of a round, learning included."""
    steps, began = model.n_envs * STEPS, time.perf_counter()
    model.learn(steps, reset_num_timesteps=False)
    return steps / (time.perf_counter() - began)


def flying_rate(env: VecEnv) -> float:
    """Environment steps per second with random actions."""
    env.reset()
    began = time.perf_counter()
    for _ in range(STEPS):
        env.step(np.random.uniform(-1, 1, (env.num_envs, *(env.action_space.shape or ()))))
    return env.num_envs * STEPS / (time.perf_counter() - began)


def measure(job: Job, rounds: int) -> dict[str, object]:
    """Environment steps per second of either, and their ratio."""
    # Its users have torch on all cores. Where other work uses them too, torch's threads mostly
    # wait for each other; then engine.threads=1 tells more.
    torch.set_num_threads(job.env.engine.threads or available_cpus())
    envs = {
        "needlehoop": StableBaselinesVecEnv(job.env),
        "dm_control": DummyVecEnv([partial(opengl_env, job.env)] * DM_CONTROL_ENVS),
    }
    models = [ppo(job, env) for env in envs.values()]
    rates = [[*map(learning_rate, models)] for _ in rounds_of(rounds + 1, "round")][1:]
    means = dict(zip(envs, map(harmonic_mean, zip(*rates, strict=True)), strict=True))
    return {
        **about(job.env),
        "encoder": job.encoder.name,
        "num_envs": {name: env.num_envs for name, env in envs.items()},
        "steps_per_second": {name: round(mean, 3) for name, mean in means.items()},
        "ratio": round(means["needlehoop"] / means["dm_control"], 1),
        "ratio_of_each_round": [round(one / two, 1) for one, two in rates],
        "dm_control_without_learning": round(flying_rate(envs["dm_control"]), 1),
    }


if __name__ == "__main__":
    values = composing.compose(sys.argv[1:], "bench_train")
    found = measure(typed_job(values), strict.value(values, "rounds", Count))
    print(yaml.safe_dump(found, sort_keys=False).rstrip())
