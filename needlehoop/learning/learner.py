"""Environment, agent and method of training, put together for a job."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase

from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.checkpoint import check_imitation, check_learner
from needlehoop.learning.collectors import LEARNER, Collector, LabellingCollector
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.encoder import convolution_dtype
from needlehoop.learning.hyperparameters import DaggerConfig, PpoConfig
from needlehoop.learning.job import Job
from needlehoop.learning.ppo import Ppo
from needlehoop.runs.machine import available_cpus

Turn = tuple[TensorDictBase, dict[str, float]]
"""A buffer ``(num_envs, horizon)``, and what learning from it reports."""

_MOST_DIVERGED = 0.01
"""Share of the episodes whose physics may diverge."""


class Reinforcement:
    """PPO: the agent acts at random and learns what pays.

    Args:
        job: its ``algo`` is PPO's.
        env: not begun.
        agent: learns.
        workers: to share the work.
        state: of an earlier learner of the same job, to go on from.
    """

    def __init__(
        self,
        job: Job,
        env: TorchRLEnv,
        agent: Agent,
        workers: Workers,
        state: dict[str, Any] | None,
    ):
        assert isinstance(job.algo, PpoConfig)
        self._env = env
        kept = (0, 1.0) if job.init is None else (job.algo.warmup, job.algo.finetune)
        self.ppo = Ppo(agent, job.algo, job.updates, job.env.seed, workers, *kept)
        if state is not None:
            check_learner(state, self.ppo, env)
            self.ppo.load_state_dict(state["ppo"])
            env.restore(state["env"])
        steps = job.buffer // job.env.num_envs
        self._collector = Collector(env, self.ppo.running, steps, workers)

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.ppo.done_updates

    def turn(self) -> Turn:
        """See ``Learner``."""
        began = time.perf_counter()
        self._env.progress(self.done_updates / self.ppo.updates)
        buffer, after = self._collector.collect()
        collected = time.perf_counter()
        losses = self.ppo.update(buffer, after)
        return buffer, {**losses, **_seconds(began, collected)}

    def state_dict(self) -> dict[str, Any]:
        """See ``Learner``."""
        return {"ppo": self.ppo.state_dict(), "env": self._env.snapshot()}


class Imitation:
    """DAgger: the agent acts more and more, and learns what the expert would have done.

    Arguments as in ``Reinforcement``. With a state, the buffers of the earlier one are repeated.
    """

    def __init__(
        self,
        job: Job,
        env: TorchRLEnv,
        agent: Agent,
        workers: Workers,
        state: dict[str, Any] | None,
    ):
        assert isinstance(job.algo, DaggerConfig)
        seed = job.env.seed
        self._env = env
        self._rises = 1.0 / (job.algo.handover * job.updates)
        self.dagger = Dagger(agent, job.algo, job.updates, seed, workers)
        self._collector = LabellingCollector(env, self.dagger.running, job.algo, seed, workers)
        if state is not None:
            check_imitation(state, self.dagger, self._collector)
            for done, actions in enumerate(state["lessons"]["flown"]):
                env.progress(done / job.updates)
                self.dagger.remember(self._collector.review(actions))
            self.dagger.load_state_dict(state["dagger"])
            self._collector.load_state_dict(state["lessons"])

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.dagger.done_updates

    def turn(self) -> Turn:
        """See ``Learner.__iter__``; episodes of the expert do not count as ended."""
        began = time.perf_counter()
        share = min(1.0, self.done_updates * self._rises)
        self._env.progress(self.done_updates / self.dagger.updates)
        buffer = self._collector.collect(share)
        collected = time.perf_counter()
        losses = self.dagger.update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return buffer, {**losses, "share": share, **_seconds(began, collected)}

    def state_dict(self) -> dict[str, Any]:
        """See ``Learner``."""
        return {"dagger": self.dagger.state_dict(), "lessons": self._collector.state_dict()}


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
        # The engine and the shards have threads of their own. torch's would wait for each other,
        # and their number would decide how sums are rounded.
        torch.set_num_threads(1)
        torch.manual_seed(job.env.seed)
        # Cut episodes show every stage to PPO's first buffer. Imitation begins with whole ones.
        self.env = TorchRLEnv(job.env, stagger=isinstance(job.algo, PpoConfig))
        self.agent = build_agent(job, self.env, self.device)
        if weights is not None:
            self.agent.load_state_dict(weights)
        self.workers = Workers(job.env.engine.threads or available_cpus())
        kind = Imitation if isinstance(job.algo, DaggerConfig) else Reinforcement
        self.method = kind(job, self.env, self.agent, self.workers, state)
        self._ended = self._diverged = 0
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

        ``seconds_collect`` and ``seconds_update`` are among what is reported. The buffer is valid
        until the next one.

        Raises:
            FloatingPointError: the physics diverges too often.
        """
        while self.done_updates < self.job.updates:
            turn = self.method.turn()
            self._check_physics(turn[0])
            yield turn

    def _check_physics(self, buffer: TensorDictBase) -> None:
        """Count the episodes that ended, and those among them whose physics diverged."""
        ends: Any = buffer["next"]
        self._ended += int(ends["done"].sum())
        self._diverged += int((ends["facts", "diverged"] & ends["done"]).sum())
        # A single one never ends a run.
        if self._diverged > max(1.0, _MOST_DIVERGED * self._ended):
            raise FloatingPointError(
                f"the physics diverged in {self._diverged} of {self._ended} episodes, more than"
                f" {_MOST_DIVERGED:.0%}; check the scene's task.timestep and sizes, or see"
                " whether the policy still gives finite actions"
            )

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next; of tensors and plain values."""
        state = {**self.method.state_dict(), "rng": torch.get_rng_state()}
        if self.device.type == "cuda":
            state["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return state


def build_agent(job: Job, env: TorchRLEnv, device: torch.device) -> Agent:
    """An untrained agent for an environment of a job."""
    dtype = convolution_dtype(job.precision, device)
    actions = job.env.episode.action_size
    return Agent(env.observation_spec, actions, job.encoder, job.network, dtype).to(device)


def agent_state(state: dict[str, Any]) -> dict[str, torch.Tensor]:
    """The agent's weights in the state of any method's learner."""
    return (state.get("ppo") or state["dagger"])["agent"]


def _seconds(began: float, collected: float) -> dict[str, float]:
    learnt = time.perf_counter()
    return {"seconds_collect": collected - began, "seconds_update": learnt - collected}
