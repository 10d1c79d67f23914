"""The methods of learning: reinforcement and imitation, with one face for the job."""

from __future__ import annotations

import time
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase

from needlehoop.envs.torchrl_env import NeedleHoopEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.checkpoint import check_learner, check_lessons
from needlehoop.learning.collector import Collector
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.hyperparameters import DaggerConfig, PpoConfig
from needlehoop.learning.job import Job
from needlehoop.learning.lessons import LEARNER, Lessons
from needlehoop.learning.ppo import Ppo

Turn = tuple[TensorDictBase, dict[str, float]]
"""A buffer ``(num_envs, horizon)``, and what learning from it reports."""


class Method(Protocol):
    """Collects a buffer and learns from it, again and again."""

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        ...

    def turn(self) -> Turn:
        """The next buffer, learnt from.

        ``seconds_collect`` and ``seconds_update`` are among what is reported. The buffer is
        valid until the next one.
        """
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next, but for torch's own generators."""
        ...


class Reinforcement:
    """PPO: the agent acts at random and learns what paid.

    Args:
        job: its ``algo`` is PPO's.
        env: not begun.
        agent: learns.
        workers: to share the work.
        state: of an earlier one of the same job, to go on from.
    """

    def __init__(
        self,
        job: Job,
        env: NeedleHoopEnv,
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
        """See ``Method``."""
        began = time.perf_counter()
        buffer, after = self._collector.collect()
        collected = time.perf_counter()
        losses = self.ppo.update(buffer, after)
        return buffer, {**losses, **_seconds(began, collected)}

    def state_dict(self) -> dict[str, Any]:
        """See ``Method``."""
        return {"ppo": self.ppo.state_dict(), "env": self._env.snapshot()}


class Imitation:
    """DAgger: the agent flies more and more, and learns what the expert would have done.

    Args:
        job: its ``algo`` is DAgger's.
        env: not begun.
        agent: learns.
        workers: to share the work.
        state: of an earlier one of the same job, to go on from: its lessons are flown again.
    """

    def __init__(
        self,
        job: Job,
        env: NeedleHoopEnv,
        agent: Agent,
        workers: Workers,
        state: dict[str, Any] | None,
    ):
        assert isinstance(job.algo, DaggerConfig)
        seed = job.env.seed
        self._rises = 1.0 / (job.algo.handover * job.updates)
        self.dagger = Dagger(agent, job.algo, job.updates, seed, workers)
        self._lessons = Lessons(env, self.dagger.running, job.algo, seed, workers)
        if state is not None:
            check_lessons(state, self.dagger, self._lessons)
            for flown in state["lessons"]["flown"]:
                self.dagger.remember(self._lessons.review(flown))
            self.dagger.load_state_dict(state["dagger"])
            self._lessons.load_state_dict(state["lessons"])

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.dagger.done_updates

    def turn(self) -> Turn:
        """See ``Method``; episodes that the expert flew do not count as ended."""
        began = time.perf_counter()
        share = min(1.0, self.done_updates * self._rises)
        buffer = self._lessons.collect(share)
        collected = time.perf_counter()
        losses = self.dagger.update(buffer)
        buffer["next", "done"] &= buffer[LEARNER]
        return buffer, {**losses, "share": share, **_seconds(began, collected)}

    def state_dict(self) -> dict[str, Any]:
        """See ``Method``."""
        return {"dagger": self.dagger.state_dict(), "lessons": self._lessons.state_dict()}


def build_method(
    job: Job,
    env: NeedleHoopEnv,
    agent: Agent,
    workers: Workers,
    state: dict[str, Any] | None,
) -> Method:
    """The method that a job's algorithm is of; arguments as in ``Reinforcement``."""
    kind = Imitation if isinstance(job.algo, DaggerConfig) else Reinforcement
    return kind(job, env, agent, workers, state)


def agent_state(state: dict[str, Any]) -> dict[str, torch.Tensor]:
    """The agent's weights in the state of any method's learner."""
    return (state.get("ppo") or state["dagger"])["agent"]


def _seconds(began: float, collected: float) -> dict[str, float]:
    learnt = time.perf_counter()
    return {"seconds_collect": collected - began, "seconds_update": learnt - collected}
