"""Environment, agent and method of learning, put together for a job."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch

from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.hyperparameters import PpoConfig
from needlehoop.learning.job import Job
from needlehoop.learning.methods import Turn, build_method
from needlehoop.learning.precision import convolution_dtype
from needlehoop.runs.machine import available_cpus


class Learner:
    """Collects buffers and learns from them.

    Args:
        job: what to build.
        state: of an earlier learner of the same job, to go on from.
        weights: of another run's agent, to begin with.

    Raises:
        ValueError: the state is of another job.
    """

    def __init__(
        self,
        job: Job,
        state: dict[str, Any] | None = None,
        weights: dict[str, torch.Tensor] | None = None,
    ):
        self.job, self.device = job, job.torch_device
        # The engine has threads of its own and learning one per shard. torch's would wait for
        # each other, and their number would decide how sums are rounded.
        torch.set_num_threads(1)
        torch.manual_seed(job.env.seed)
        # Lessons begin with whole episodes; cut ones show PPO's first buffer every stage.
        self.env = NeedleHoopEnv(job.env, stagger=isinstance(job.algo, PpoConfig))
        self.agent = build_agent(job, self.env, self.device)
        if weights is not None:
            self.agent.load_state_dict(weights)
        self.workers = Workers(job.env.engine.threads or available_cpus())
        self.method = build_method(job, self.env, self.agent, self.workers, state)
        if state is not None:
            # Last: building an agent draws numbers.
            torch.set_rng_state(state["rng"])
            if self.device.type == "cuda":
                torch.cuda.set_rng_state(state["cuda_rng"], self.device)

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.method.done_updates

    @property
    def steps(self) -> int:
        """Environment steps learnt from."""
        return self.done_updates * self.job.buffer

    def __iter__(self) -> Iterator[Turn]:
        """Each buffer ``(num_envs, horizon)``, after it was learnt from, and what is reported.

        ``seconds_collect`` and ``seconds_update`` are among the latter. The buffer is valid
        until the next one.
        """
        while self.done_updates < self.job.updates:
            yield self.method.turn()

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next; of tensors and plain values."""
        state = {**self.method.state_dict(), "rng": torch.get_rng_state()}
        if self.device.type == "cuda":
            state["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return state


def build_agent(job: Job, env: NeedleHoopEnv, device: torch.device) -> Agent:
    """An untrained agent for an environment of a job."""
    dtype = convolution_dtype(job.precision, device)
    actions = job.env.episode.action_size
    return Agent(env.observation_spec, actions, job.encoder, job.algo.network, dtype).to(device)
