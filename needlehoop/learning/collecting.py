"""The environments of a training, and TorchRL's collectors that fill its buffers.

On this machine, or on several by Ray (``needlehoop[ray]``).
"""

from __future__ import annotations

import os
import pickle
import signal
import warnings
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from itertools import chain
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.envs import Compose, EnvBase, TransformedEnv, UnaryTransform

from needlehoop import rewards
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.algorithm_config import DaggerConfig, PpoConfig
from needlehoop.learning.encoder import Fold
from needlehoop.learning.job import Job
from needlehoop.learning.transforms import Carry, Teacher
from needlehoop.runs.machine import import_extra
from needlehoop.tasks import registry


class MakeEnv:
    """Makes the ``count`` environments of a job from the ``first`` on, in any process.

    A user's own task or reward is imported anew there.
    """

    def __init__(self, job: Job, first: int, count: int, threads: int):
        env = job.env
        self._task, self._first, self._count = (env.task.name, env.task_dir), first, count
        self._threads, self._alone = threads, count == env.num_envs
        reward = {key: value for key, value in env.reward.items() if key != rewards.CALL}
        self._job = pickle.dumps(replace(job, env=replace(env, reward=reward)))

    def __call__(self) -> EnvBase:
        if not self._alone:
            # Only the process that trains reacts to signals; these end with it.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            torch.set_num_threads(1)
        registry.add(*self._task)
        job: Job = pickle.loads(self._job)
        env, algo = job.env, job.algo
        # torch takes no larger ones.
        seed = (env.seed * 2**20 + self._first) % 2**63
        torch.manual_seed(seed)
        engine = replace(env.engine, threads=self._threads)
        settings = replace(
            env, num_envs=self._count, engine=engine, reward=rewards.with_function(env.reward)
        )
        stagger = isinstance(algo, PpoConfig)
        base = TorchRLEnv(settings, self._first, stagger, job.steps // env.num_envs)
        images: Any = [("pixels", name) for name in env.image_channels]
        fold = UnaryTransform(images, images, fn=Fold(job.encoder.stem))
        changes: list[Any] = [fold, Carry()]
        if isinstance(algo, DaggerConfig):
            changes.append(Teacher(settings, algo.noise, algo.handover, seed))
        return TransformedEnv(base, Compose(*changes))


def collector_of(job: Job, policy: TensorDictModuleBase, device: torch.device) -> Any:
    """A collector of the job's kind, which fills buffers ``(num_envs, horizon)`` on a device."""
    cores, engine = job.env.engine.cpus, job.env.engine
    parts = job.collector.parts(job.env.num_envs, cores)
    if engine.kind == "warp":
        # A device steps all environments at once, in the process that learns.
        parts = [job.env.num_envs]
    makers = [
        MakeEnv(job, sum(parts[:at]), count, max(1, cores // len(parts)))
        for at, count in enumerate(parts)
    ]
    if job.collector.kind == "ray":
        return RayBuffers(makers, policy, job.buffer, device)
    shared: dict[str, Any] = {
        "env_device": engine.device,
        "policy_device": device,
        "storing_device": device,
        "total_frames": -1,
        "auto_register_policy_transforms": False,
    }
    if len(parts) == 1:
        return Collector(
            makers[0](),
            policy,
            frames_per_batch=job.buffer,
            track_traj_ids=False,
            # On a GPU, the same memory again would put the learner on the collector's stream.
            return_same_td=device.type == "cpu",
            **shared,
        )
    steps = job.buffer // job.env.num_envs
    return MultiSyncCollector(
        makers,
        policy,
        frames_per_batch=[count * steps for count in parts],
        cat_results=0,
        use_buffers=True,
        # This process learns on all cores while the workers wait.
        num_threads=cores,
        **shared,
    )


def replayed(job: Job, flown: Tensor) -> Iterator[TensorDictBase]:
    """Collects earlier buffers once more, by replaying their actions.

    ``flown``: the actions ``(buffers, num_envs, horizon, size)``.
    """
    env = MakeEnv(job, 0, job.env.num_envs, job.env.engine.cpus)()
    now = env.reset()
    for actions in flown:
        steps: list[Any] = []
        for action in actions.unbind(1):
            now["action"] = action.to(env.device)
            both, now = env.step_and_maybe_reset(now)
            steps.append(both)
        buffer: Any = torch.stack(steps, 1)
        yield buffer
    env.close()


class _Worker(Collector):
    """Ray asks whether an actor is true, which would call ``len`` of an endless collector."""

    def __bool__(self) -> bool:
        return True


class RayBuffers:
    """Buffers ``(num_envs, horizon)`` of workers that share the environments equally.

    The cluster is that of ``RAY_ADDRESS``, or else a new one on this machine. Each worker acts on
    a CPU, whatever the learner's device. ``steps``: of a buffer, over all environments.

    Raises:
        ValueError: Ray is not installed, or its cluster has fewer CPUs than workers.
    """

    def __init__(
        self,
        makers: Sequence[MakeEnv],
        policy: TensorDictModuleBase,
        steps: int,
        device: torch.device,
    ):
        # Ray would start a second cluster where a process ends before its collector.
        os.environ.setdefault("RAY_ENABLE_AUTO_CONNECT", "0")
        ray = import_extra("ray", "collector=ray", "ray")
        from torchrl.collectors.distributed import RayCollector

        count = len(makers)
        if not ray.is_initialized():
            here = None if "RAY_ADDRESS" in os.environ else count
            ray.init(num_cpus=here, include_dashboard=False, log_to_driver=False)
        # Ray would wait for missing CPUs without end, and without a message.
        there = int(ray.cluster_resources().get("CPU", 0))
        if there < count:
            raise ValueError(f"collector.workers: {count} is more than the cluster's {there} CPUs")
        self._policy, self._device = policy, device
        self._count = count
        cpu = torch.device("cpu")
        kind: Any = _Worker
        # RayCollector would collect nothing for -1.
        endless: Any = float("inf")
        self._collector = RayCollector(
            list(makers),
            deepcopy(policy).to(cpu),
            frames_per_batch=steps,
            total_frames=endless,
            sync=True,
            collector_class=kind,
            remote_configs={"num_cpus": 1},
            env_device=cpu,
            policy_device=cpu,
            storing_device=cpu,
        )

    def __iter__(self) -> Iterator[TensorDictBase]:
        with warnings.catch_warnings():
            # It warns that it has no way of its own to send weights.
            warnings.simplefilter("ignore", UserWarning)
            buffers: Any = iter(self._collector)
            first = next(buffers)
        for buffer in chain([first], buffers):
            yield buffer.flatten(0, 1).to(self._device)

    def update_policy_weights_(self) -> None:
        """Send the weights. TorchRL's own way fails on convolutions in ``channels_last``."""
        weights = {name: one.cpu() for name, one in self._policy.state_dict().items()}
        self._collector.map_fn("policy.load_state_dict", [(weights,)] * self._count)

    def state_dict(self) -> dict[str, Any]:
        """Of each worker, by name."""
        states: Any = self._collector.state_dict()
        return {f"worker{i}": dict(state) for i, state in enumerate(states)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict``."""
        self._collector.load_state_dict([state[f"worker{i}"] for i in range(self._count)])

    def reset(self) -> None:
        """Show where the environments stand."""
        self._collector.map_fn("reset", [()] * self._count)

    def shutdown(self) -> None:
        """End the workers, and a cluster that was begun for them."""
        self._collector.shutdown()
