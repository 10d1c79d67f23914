"""Environment, agent and method of training, put together for a job."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent
from needlehoop.learning.collectors import Collector, LabellingCollector
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.encoder import convolution_dtype
from needlehoop.learning.job import DaggerConfig, Job, PpoConfig
from needlehoop.learning.ppo import Ppo
from needlehoop.learning.weights import Senses
from needlehoop.runs.files import DAGGER, PPO
from needlehoop.runs.machine import available_cpus
from needlehoop.runs.run import ADVICE

_MOST_DIVERGED = 0.01
"""Share of the episodes whose physics may diverge."""


class Learner:
    """Collects buffers and learns from them.

    Args:
        state: of an earlier learner of the job.
        weights: of another run's agent, to begin with.

    Raises:
        ValueError: the state is of another job, or of another version.
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
        self.agent = build_agent(job, self.device)
        if weights is not None:
            self.agent.load_state_dict(weights)
        self.workers = Workers(job.env.engine.threads or available_cpus())
        shared = (job.updates, job.env.seed, self.workers)
        if isinstance(job.algo, DaggerConfig):
            self.trainer = Dagger(self.agent, job.algo, *shared)
            own = (job.algo, job.env.seed, self.workers)
            self._collector: Any = LabellingCollector(self.env, self.trainer.running, *own)
        else:
            # A new agent has nothing to lose.
            new = replace(job.algo, warmup=0, finetune=1.0)
            self.trainer = Ppo(self.agent, new if job.init is None else job.algo, *shared)
            steps = job.buffer // job.env.num_envs
            self._collector = Collector(self.env, self.trainer.running, steps, self.workers)
        self._ended = self._diverged = 0
        if state is not None:
            with _fitting("checkpoint"):
                self._go_on(state)

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.trainer.done_updates

    @property
    def steps(self) -> int:
        """Environment steps learnt from."""
        return self.done_updates * self.job.buffer

    def __iter__(self) -> Iterator[tuple[TensorDictBase, dict[str, float]]]:
        """Each buffer ``(num_envs, horizon)``, after it was learnt from, and what is reported.

        The buffer is valid until the next one.

        Raises:
            FloatingPointError: the physics diverges too often.
        """
        trainer: Any = self.trainer
        while self.done_updates < self.job.updates:
            began = time.perf_counter()
            self.env.progress(self.done_updates / self.job.updates)
            if isinstance(self.trainer, Dagger):
                given = (self._collector.collect(self.trainer.share),)
            else:
                given = self._collector.collect()
            collected = time.perf_counter()
            told = trainer.update(*given)
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
        trained = {_method_of(self.job): self.trainer.state_dict()}
        found = {**trained, **self._collector.state_dict(), "rng": torch.get_rng_state()}
        if self.device.type == "cuda":
            found["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return found

    def _go_on(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self.trainer.load_state_dict(state[_method_of(self.job)])
        if isinstance(self.trainer, Dagger):
            for done, actions in enumerate(state["lessons"]["flown"]):
                self.env.progress(done / self.job.updates)
                self.trainer.remember(self._collector.review(actions))
        self._collector.load_state_dict(state)
        # Last: building an agent draws numbers.
        torch.set_rng_state(state["rng"])
        if self.device.type == "cuda":
            torch.cuda.set_rng_state(state["cuda_rng"], self.device)


def _method_of(job: Job) -> str:
    """What a checkpoint calls a job's method of training."""
    return DAGGER if isinstance(job.algo, DaggerConfig) else PPO


def check_state(path: Path, state: Mapping[str, Any], job: Job) -> None:
    """Check that a checkpoint was made by a job, as far as can be told before anything is built.

    Args:
        state: its ``update``, ``wall_time`` and ``learner``.

    Raises:
        ValueError: it was not.
    """
    method, update = _method_of(job), state.get("update")
    learner: Any = state.get("learner")
    done = learner[method].get("done_updates") if method in (learner or ()) else None
    if "wall_time" not in state or done is None or done != update or not 0 < done <= job.updates:
        raise ValueError(
            f"{path} does not fit its run of {job.updates} updates: update: {update}, that of"
            f" learner.{method}: {done}; {ADVICE}"
        )


def load_weights(path: Path, state: Mapping[str, Any], job: Job, agent: Agent) -> None:
    """Put a checkpoint's weights into an agent of its job; errors as in ``check_state``."""
    check_state(path, state, job)
    with _fitting(str(path)):
        agent.load_state_dict(state["learner"][_method_of(job)]["agent"])


@contextmanager
def _fitting(what: str) -> Iterator[None]:
    """Raises ``ValueError`` in one line where a state does not fit what it is put into."""
    try:
        yield
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        said = str(error).splitlines()[-1].strip()
        raise ValueError(f"{what}: of another run, or another version: {said}") from error


def build_agent(job: Job, device: torch.device) -> Agent:
    """An untrained agent of a job; needs no simulator."""
    own, dtype = Senses.of(job), convolution_dtype(job.precision, device)
    made = Agent(own.images, own.vectors, own.actions, own.encoder, own.network, dtype)
    return made.to(device)
