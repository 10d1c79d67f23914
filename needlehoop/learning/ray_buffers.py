"""One training over several machines: TorchRL's Ray collector (``needlehoop[ray]``)."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from itertools import chain
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector

# Ray would start a second cluster where a process ends before its collector.
os.environ.setdefault("RAY_ENABLE_AUTO_CONNECT", "0")


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
        makers: Sequence[Callable[[], Any]],
        policy: TensorDictModuleBase,
        steps: int,
        device: torch.device,
    ):
        try:
            import ray
            from torchrl.collectors.distributed import RayCollector
        except ImportError as error:
            raise ValueError(
                "collector: ray is not installed: pip install 'needlehoop[ray]'"
            ) from error
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
