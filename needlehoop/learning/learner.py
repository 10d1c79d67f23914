"""Environments, agent and method of training, put together for a job."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase

from needlehoop.learning.algorithm import Algorithm, MemoryAlgorithm
from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.collecting import collector_of, replayed
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.job import Job
from needlehoop.learning.networks import Agent
from needlehoop.learning.policy import fitting
from needlehoop.learning.ppo import Ppo
from needlehoop.learning.sac import Sac
from needlehoop.runs.files import DAGGER, PPO, SAC

ALGORITHMS: dict[str, type[Algorithm]] = {PPO: Ppo, DAGGER: Dagger, SAC: Sac}
"""By ``algo.kind``; each has its settings in a file of ``conf/algo``."""


class Learner:
    """Collects buffers and learns from them.

    ``state``: of an earlier learner of the job, to go on from; ``ValueError`` if it does not fit.
    ``weights``: of another run's agent, to begin with.
    """

    def __init__(
        self,
        job: Job,
        state: dict[str, Any] | None = None,
        weights: dict[str, torch.Tensor] | None = None,
    ):
        self.job, self.device = job, job.torch_device
        torch.set_num_threads(job.env.engine.cpus)
        torch.manual_seed(job.env.seed)
        self.agent = build_agent(job, self.device)
        if weights is not None:
            self.agent.load_state_dict(weights)
        algo = job.algo
        if isinstance(algo, PpoConfig) and job.init is None:
            # A new agent has nothing to protect.
            algo = replace(algo, warmup=0, finetune=1.0)
        kind = ALGORITHMS[algo.kind]
        self.algorithm: Any = kind(self.agent, algo, job.updates, job.env.seed)
        self._flown: list[torch.Tensor] = []
        self._ended = self._diverged = 0
        if state is None:
            self._collector = collector_of(job, self.algorithm.policy, self.device)
            return
        with fitting("checkpoint"):
            self.algorithm.load_state_dict(state[algo.kind])
            # As many workers as before: each goes on from its own state.
            workers = sum(key.startswith("worker") for key in state["collector"]) or 1
            job = replace(job, collector=replace(job.collector, workers=workers))
            self._collector = collector_of(job, self.algorithm.policy, self.device)
            self._go_on(state)

    @property
    def done_updates(self) -> int:
        """Buffers learnt from."""
        return self.algorithm.done_updates

    @property
    def steps(self) -> int:
        """Environment steps learnt from."""
        return self.done_updates * self.job.buffer

    def __iter__(self) -> Iterator[tuple[TensorDictBase, dict[str, float]]]:
        """Each buffer ``(num_envs, horizon)``, after it was learnt from, and what is reported.

        A buffer is valid until the next. ``FloatingPointError``: the physics diverges too often.
        """
        buffers = iter(self._collector)
        while self.done_updates < self.job.updates:
            began = time.perf_counter()
            buffer = next(buffers)
            collected = time.perf_counter()
            losses = self.algorithm.update(buffer)
            self._collector.update_policy_weights_()
            if isinstance(self.algorithm, MemoryAlgorithm):
                self._flown.append(buffer["action"].cpu().clone())
            losses["seconds_collect"] = collected - began
            losses["seconds_update"] = time.perf_counter() - collected
            self._check_physics(buffer)
            yield buffer, losses

    def _check_physics(self, buffer: TensorDictBase) -> None:
        """Count the episodes that ended, and those among them whose physics diverged."""
        ends: Any = buffer["next"]
        self._ended += int(ends["done"].sum())
        self._diverged += int((ends["facts", "diverged"] & ends["done"]).sum())
        # A single episode never ends a run.
        if self._diverged > max(1.0, 0.01 * self._ended):
            raise FloatingPointError(
                f"the physics diverged in {self._diverged} of {self._ended} episodes, more than 1%;"
                " check the scene's task.timestep and sizes, or see whether the policy still gives"
                " finite actions"
            )

    def close(self) -> None:
        """End the collector's processes."""
        self._collector.shutdown()

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides what comes next; of tensors and plain values."""
        state: dict[str, Any] = {
            "collector": self._collector.state_dict(),
            self.job.algo.kind: self.algorithm.state_dict(),
            "rng": torch.get_rng_state(),
        }
        if self._flown:
            # Actions take a thousandth of the space of the frames, which are collected again.
            state["flown"] = torch.stack(self._flown)
        if self.device.type == "cuda":
            state["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        return state

    def _go_on(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        if "flown" in state:
            self._flown = [*state["flown"]]
            for buffer in replayed(self.job, state["flown"]):
                self.algorithm.remember(buffer)
        self._collector.load_state_dict(state["collector"])
        # A reset after loading shows the episodes under way.
        self._collector.reset()
        # Last, because building an agent draws numbers.
        torch.set_rng_state(state["rng"])
        if self.device.type == "cuda":
            torch.cuda.set_rng_state(state["cuda_rng"], self.device)


def build_agent(job: Job, device: torch.device) -> Agent:
    """An untrained agent of a job; needs no simulator."""
    return ALGORITHMS[job.algo.kind].agent_class(job.spec, device).to(device)
