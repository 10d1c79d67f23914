"""The environments of a training, and TorchRL's collectors that fill its buffers."""

from __future__ import annotations

import pickle
import signal
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.envs import Compose, EnvBase, TransformedEnv

from needlehoop import rewards
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.algorithm_config import DaggerConfig
from needlehoop.learning.job import Job
from needlehoop.learning.transforms import Carry, FoldPixels, Teacher
from needlehoop.tasks import registry


class MakeEnv:
    """Makes the ``count`` environments of a job from the ``first`` on, in any process.

    A user's own task or reward is imported anew there.
    """

    def __init__(self, job: Job, first: int, count: int, threads: int):
        env = job.env
        self._task, self._first, self._count = (env.task.name, env.task_dir), first, count
        self._threads, self._alone = threads, count == env.num_envs
        reward = {key: one for key, one in env.reward.items() if key != rewards.CALL}
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
        own = replace(
            env, num_envs=self._count, engine=engine, reward=rewards.with_function(env.reward)
        )
        base = TorchRLEnv(own, self._first, algo.stagger, job.steps // env.num_envs)
        changes: list[Any] = [FoldPixels(job.encoder.stem, list(env.image_channels)), Carry()]
        if isinstance(algo, DaggerConfig):
            changes.append(Teacher(own, algo.noise, algo.handover, seed))
        return TransformedEnv(base, Compose(*changes))


def collector_of(job: Job, policy: TensorDictModuleBase, device: torch.device) -> Any:
    """A collector of the job's kind, which fills buffers ``(num_envs, horizon)`` on a device."""
    cores, engine = job.env.engine.cpus, job.env.engine
    parts = job.collector.parts(job.env.num_envs, cores)
    if engine.kind == "warp":
        # A device steps all environments at once, in the process that learns.
        parts = [job.env.num_envs]
    firsts = [sum(parts[:i]) for i in range(len(parts))]
    makers = [
        MakeEnv(job, first, count, max(1, cores // len(parts)))
        for first, count in zip(firsts, parts, strict=True)
    ]
    if job.collector.kind == "ray":
        # Ray is an extra.
        from needlehoop.learning.ray_buffers import RayBuffers

        return RayBuffers(makers, policy, job.buffer, device)
    shared: dict[str, Any] = {
        "env_device": engine.device,
        "policy_device": device,
        "total_frames": -1,
    }
    shared |= {"storing_device": device, "auto_register_policy_transforms": False}
    if len(parts) == 1:
        # On a GPU, the same memory again would put the learner on the collector's stream.
        same = device.type == "cpu"
        own = {"frames_per_batch": job.buffer, "track_traj_ids": False, "return_same_td": same}
        return Collector(makers[0](), policy, **own, **shared)
    steps = job.buffer // job.env.num_envs
    own: dict[str, Any] = {"frames_per_batch": [count * steps for count in parts]}
    # This process learns on all cores while the workers wait.
    own |= {"cat_results": 0, "use_buffers": True, "num_threads": cores}
    return MultiSyncCollector(makers, policy, **own, **shared)


def flown_again(job: Job, flown: Tensor) -> Iterator[TensorDictBase]:
    """Earlier buffers again, from their actions ``(buffers, num_envs, horizon, size)``."""
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
