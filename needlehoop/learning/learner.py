"""Environment, agent, collector and PPO, put together for a job."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase

from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.checkpoint import check_learner
from needlehoop.learning.collector import Collector
from needlehoop.learning.job import Job
from needlehoop.learning.ppo import Ppo
from needlehoop.learning.precision import convolution_dtype
from needlehoop.runs.machine import available_cpus


class Learner:
    """Collects buffers and learns from them.

    Args:
        job: what to build.
        state: of an earlier learner of the same job, to go on from.

    Raises:
        ValueError: the state is of another job.
    """

    def __init__(self, job: Job, state: dict[str, Any] | None = None):
        self.job, self.device = job, job.torch_device
        # The engine has threads of its own and PPO one per shard. torch's would wait for each
        # other, and their number would decide how sums are rounded.
        torch.set_num_threads(1)
        torch.manual_seed(job.env.seed)
        self.env = NeedleHoopEnv(job.env, stagger=True)
        self.agent = build_agent(job, self.env, self.device)
        threads = job.env.engine.threads or available_cpus()
        self.workers = Workers(threads)
        self.ppo = Ppo(self.agent, job.algo, job.updates, job.env.seed, self.workers)
        if state is not None:
            check_learner(state, self.ppo, self.env)
            self.ppo.load_state_dict(state["ppo"])
            self.env.restore(state["env"])
        self._collector = Collector(self.env, self.ppo.running, job.algo.horizon, self.workers)
        if state is not None:
            # Last: building an agent draws numbers.
            torch.set_rng_state(state["rng"])
            if self.device.type == "cuda":
                torch.cuda.set_rng_state(state["cuda_rng"], self.device)

    @property
    def steps(self) -> int:
        """Environment steps learnt from."""
        return self.ppo.done_updates * self.job.buffer

    def __iter__(self) -> Iterator[tuple[TensorDictBase, dict[str, float]]]:
        """Each buffer ``(num_envs, horizon)``, after it was learnt from, and what PPO says.

        ``seconds_collect`` and ``seconds_update`` are among the latter. The buffer is valid
        until the next one.
        """
        began = time.perf_counter()
        while self.ppo.done_updates < self.job.updates:
            buffer, after = self._collector.collect()
            collected = time.perf_counter()
            losses = self.ppo.update(buffer, after)
            learnt = time.perf_counter()
            seconds = {"seconds_collect": collected - began, "seconds_update": learnt - collected}
            yield buffer, {**losses, **seconds}
            began = time.perf_counter()

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next; of tensors and plain values."""
        state = {
            "ppo": self.ppo.state_dict(),
            "env": self.env.snapshot(),
            "rng": torch.get_rng_state(),
        }
        if self.device.type == "cuda":
            state["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return state


def build_agent(job: Job, env: NeedleHoopEnv, device: torch.device) -> Agent:
    """An untrained agent for an environment of a job."""
    dtype = convolution_dtype(job.precision, device)
    actions = job.env.episode.action_size
    return Agent(env.observation_spec, actions, job.encoder, job.algo.network, dtype).to(device)
