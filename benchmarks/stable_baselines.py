"""Speed of Stable-Baselines3's PPO on our environments and on dm_control's. Extra ``sb3``.

    python benchmarks/stable_baselines.py 3 engine.threads=1

The words are the number of rounds and settings of ``python train.py``. Both learn with the same
hyperparameters and encoders, in turns in one process; one round before them warms up.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from statistics import harmonic_mean
from typing import Any

import torch
from environment import NO_OPENGL
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch import Tensor, nn
from training import job_of

from needlehoop.gym.stable_baselines import StableBaselinesVecEnv
from needlehoop.learning.encoder import Encoder, Fold, convolution_dtype
from needlehoop.learning.job import Job
from needlehoop.runs.machine import available_cpus

DM_CONTROL_ENVS = 8
"""The paper's number of environments."""

STEPS = 32
"""Of each environment per round; times the above, one minibatch."""


class Encoders(BaseFeaturesExtractor):
    """Our encoders, one per camera, side by side."""

    def __init__(self, observation_space: spaces.Dict, job: Job, dtype: torch.dtype):
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


def runner(job: Job, env: VecEnv) -> Callable[[], float]:
    """A call that does a round of SB3's PPO, learning included, and returns steps per second."""
    dtype = convolution_dtype(job.precision, job.torch_device)
    model = PPO(
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
    steps = env.num_envs * STEPS

    def run() -> float:
        # Its users have torch on all cores. Where other work uses them too, torch's threads
        # mostly wait for each other; then engine.threads=1 tells more.
        before = torch.get_num_threads()
        torch.set_num_threads(job.env.engine.threads or available_cpus())
        began = time.perf_counter()
        model.learn(steps, reset_num_timesteps=False)
        seconds = time.perf_counter() - began
        torch.set_num_threads(before)
        return steps / seconds

    return run


if __name__ == "__main__":
    rounds, *words = sys.argv[1:]
    job = job_of(words)
    try:
        # Finds an OpenGL library when it is imported, or raises.
        from opengl import OpenGLEnvironment

        makers: list[Any] = [
            partial(OpenGLEnvironment, job.env, env) for env in range(DM_CONTROL_ENVS)
        ]
        # Stepped one after the other.
        drawn = DummyVecEnv(makers)
        drawn.reset()
    except NO_OPENGL as error:
        sys.exit(f"no OpenGL: {type(error).__name__}: {error}")
    runs = runner(job, StableBaselinesVecEnv(job.env)), runner(job, drawn)
    rates = [[run() for run in runs] for _ in range(int(rounds) + 1)][1:]
    ours, dm_control = (harmonic_mean(column) for column in zip(*rates, strict=True))
    print(f"needlehoop, {job.env.num_envs} environments: {ours:.1f} steps/s")
    print(f"dm_control, {DM_CONTROL_ENVS} environments: {dm_control:.1f} steps/s")
    print("ratio of each round:", *(f"{a / b:.1f}" for a, b in rates))
