"""Environment, agent and method of training, put together for a job."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.checkpoint import check_like
from needlehoop.learning.collectors import Collector, LabellingCollector
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.encoder import convolution_dtype
from needlehoop.learning.hyperparameters import DaggerConfig, PpoConfig
from needlehoop.learning.job import Job
from needlehoop.learning.ppo import Ppo
from needlehoop.runs.files import DAGGER, PPO
from needlehoop.runs.machine import available_cpus

Turn = tuple[TensorDictBase, dict[str, float]]
"""A buffer ``(num_envs, horizon)``, and what learning from it reports."""

_MOST_DIVERGED = 0.01
"""Share of the episodes whose physics may diverge."""


class Reinforcement:
    """PPO: the agent acts at random and learns what pays."""

    name = PPO

    def __init__(self, job: Job, env: TorchRLEnv, agent: Agent, workers: Workers):
        assert isinstance(job.algo, PpoConfig)
        kept = (0, 1.0) if job.init is None else (job.algo.warmup, job.algo.finetune)
        self.trainer = Ppo(agent, job.algo, job.updates, job.env.seed, workers, *kept)
        steps = job.buffer // job.env.num_envs
        self._env, self._collector = env, Collector(env, self.trainer.running, steps, workers)

    def collect(self) -> tuple[TensorDict, TensorDict]:
        """What the trainer's ``update`` takes, of which the buffer is the first."""
        return self._collector.collect()

    def state_dict(self) -> dict[str, Any]:
        """What decides the next buffer, beside the trainer's state."""
        return {"env": self._env.snapshot()}

    def blank(self, done: int) -> dict[str, Any]:
        """A state as it is after so many buffers, to compare a checkpoint with."""
        self._env.reset()
        return self.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self._env.restore(state["env"])


class Imitation:
    """DAgger: the agent acts more and more, and learns what the expert would have done.

    Methods as in ``Reinforcement``. To go on, it repeats the buffers so far.
    """

    name = DAGGER

    def __init__(self, job: Job, env: TorchRLEnv, agent: Agent, workers: Workers):
        assert isinstance(job.algo, DaggerConfig)
        seed = job.env.seed
        self._env = env
        self.trainer = Dagger(agent, job.algo, job.updates, seed, workers)
        self._collector = LabellingCollector(env, self.trainer.running, job.algo, seed, workers)

    def collect(self) -> tuple[TensorDict]:
        return (self._collector.collect(self.trainer.share),)

    def state_dict(self) -> dict[str, Any]:
        return {"lessons": self._collector.state_dict()}

    def blank(self, done: int) -> dict[str, Any]:
        return {"lessons": {**self._collector.state_dict(), "flown": self._collector.blank(done)}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        for done, actions in enumerate(state["lessons"]["flown"]):
            self._env.progress(done / self.trainer.updates)
            self.trainer.remember(self._collector.review(actions))
        self._collector.load_state_dict(state["lessons"])


class Learner:
    """Collects buffers and learns from them.

    Args:
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
        self.method = kind(job, self.env, self.agent, self.workers)
        self._ended = self._diverged = 0
        if state is not None:
            self._go_on(state)

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.method.trainer.done_updates

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
            began = time.perf_counter()
            self.env.progress(self.done_updates / self.job.updates)
            given: Any = self.method.collect()
            collected = time.perf_counter()
            told = self.method.trainer.update(*given)
            told["seconds_collect"] = collected - began
            told["seconds_update"] = time.perf_counter() - collected
            self._check_physics(given[0])
            yield given[0], told

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
        trained = {self.method.name: self.method.trainer.state_dict()}
        return {**trained, **self.method.state_dict(), **self._generators()}

    def _generators(self) -> dict[str, Any]:
        found = {"rng": torch.get_rng_state()}
        if self.device.type == "cuda":
            found["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return found

    def _go_on(self, state: Mapping[str, Any]) -> None:
        """Go on from the ``state_dict`` of an earlier learner of the same job."""
        name, trainer = self.method.name, self.method.trainer
        rest = self.method.blank(state[name]["done_updates"])
        like = {name: trainer.state_dict(), **rest, **self._generators()}
        check_like("learner", {key: state[key] for key in like if key in state}, like)
        trainer.load_state_dict(state[name])
        self.method.load_state_dict(state)
        # Last: building an agent draws numbers.
        torch.set_rng_state(state["rng"])
        if self.device.type == "cuda":
            torch.cuda.set_rng_state(state["cuda_rng"], self.device)


def build_agent(job: Job, env: TorchRLEnv, device: torch.device) -> Agent:
    """An untrained agent for an environment of a job."""
    dtype = convolution_dtype(job.precision, device)
    actions = job.env.episode.action_size
    return Agent(env.observation_spec, actions, job.encoder, job.network, dtype).to(device)
