"""A task as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Observer, StepResult
from needlehoop.scene.image_size import sides


class TorchRLEnv(EnvBase):
    """``num_envs`` environments in lockstep, batch size ``(num_envs,)``.

    Keys: ``("pixels", <camera>)`` uint8 ``(n, frame_stack * channels, h, w)``; optionally
    ``proprio`` float32 ``(n, 8)`` (six joints, jaw, jaw command), ``signals`` and
    ``privileged_facts`` float32; for logging ``("facts", <name>)`` bool, ``("terms", <name>)``
    and ``potential`` float32 and ``steps`` int64, all ``(n, 1)``. ``action`` float32 ``(n, 5)``
    in [-1, 1], ``(n, 7)`` with ``control=pose``. Success terminates; the time limit truncates.

    ``state_dict`` and ``load_state_dict`` carry a run on, bit for bit, in another process.

    Args:
        first_env: index of the first environment among all that share the seed.
        stagger: whether the first episodes are cut off at evenly spread times. Then environments
            in lockstep are at different stages of their episodes.
        length: steps of each environment in a training, for ``disturb.ramp``; ``None``: none
            is under way, and disturbances have their full amounts.
    """

    def __init__(
        self,
        settings: Settings,
        first_env: int = 0,
        stagger: bool = False,
        length: int | None = None,
    ):
        self.settings, self._stagger, self._length = settings, stagger, length
        self.simulation = build(settings, first_env)
        """The simulation inside: signals, state, engine."""
        self._observer = Observer(self.simulation)
        self._aside = None
        # Warp's current device and stream are all threads'.
        if settings.engine.cpus > 1 and settings.engine.kind != "warp":
            alone = {"initializer": torch.set_num_threads, "initargs": (1,)}
            self._aside = ThreadPoolExecutor(1, **alone)
        self._is_restored, self._taken = False, 0
        n = settings.num_envs
        super().__init__(device=self.simulation.device, batch_size=torch.Size([n]))
        self.moment = moment = self.simulation.reset()
        """What is known now; the signals among it are the whole state."""
        # The reset above began each environment's first episode; reseed, so that it comes again.
        self.simulation.reseed(settings.seed)

        def group(names: Iterable[str], kind: Callable[[], Any]) -> Composite:
            return Composite({name: kind() for name in names}, shape=(n,))

        def number(dtype: torch.dtype = torch.float32) -> Unbounded:
            return Unbounded(shape=torch.Size((n, 1)), dtype=dtype)

        def flag() -> Binary:
            return Binary(1, shape=torch.Size((n, 1)), dtype=torch.bool)

        width, height = sides(settings.image_size)
        pixels = Composite(shape=(n,))
        for name, channels in settings.image_channels.items():
            shape = torch.Size((n, channels, height, width))
            pixels[name] = Bounded(0, 255, shape=shape, dtype=torch.uint8)
        observed = Composite({"pixels": pixels} if settings.cameras else {}, shape=(n,))
        for name, length in settings.vectors.items():
            observed[name] = Unbounded(shape=torch.Size((n, length)))
        observed["facts"] = group(moment.facts, flag)
        observed["terms"] = group(moment.terms, number)
        observed["potential"], observed["steps"] = number(), number(torch.int64)
        self.observation_spec, self.reward_spec = observed, number()
        self.done_spec = group(("done", "terminated", "truncated"), flag)
        size = torch.Size((n, settings.episode.action_size))
        self.action_spec = Bounded(-1.0, 1.0, shape=size, dtype=torch.float32)

    def state_dict(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Everything that decides what comes next, as tensors."""
        return {
            "simulation": self.simulation.snapshot(),
            "pixels": dict(self._observer.pixels),
            "taken": torch.tensor(self._taken),
        }

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> None:
        """Go on from the ``state_dict`` of an environment with the same settings.

        The next full reset begins no episode: it returns those under way as they stood.
        """
        self.simulation.restore(state_dict["simulation"])
        kept = state_dict["pixels"].items()
        self._observer.pixels = {name: one.to(self.device) for name, one in kept}
        self._taken = int(state_dict["taken"])
        self._is_restored = True

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDict:
        resets = None if tensordict is None else tensordict.get("_reset", None)
        if self._is_restored and (resets is None or bool(resets.all())):
            self._is_restored = False
            none = torch.zeros(0, dtype=torch.int64, device=self.device)
            return self._tensordict(self.simulation.look(), none)
        mask = None if resets is None else resets.reshape(self.batch_size[0])
        first = self.simulation.state is None
        if first:
            self._observer.pixels = {}
        disturbance, ramp = self.simulation.disturbance, self.settings.disturb.ramp
        if disturbance is not None:
            # Of the episodes that begin now.
            disturbance.level = min(1.0, self.done_share / ramp) if ramp > 0 else 1.0
        self.simulation.begin(mask, stagger=self._stagger)
        fresh = None if mask is None or first else mask.nonzero().flatten()
        images = self.begin_look(fresh)
        # TorchRL fills in that nothing has ended.
        return self._tensordict(self.simulation.look(), fresh, images)

    @property
    def done_share(self) -> float:
        """Share of the training that is done; 1 where none is under way."""
        return 1.0 if self._length is None else min(1.0, self._taken / self._length)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self._taken += 1
        simulation = self.simulation
        simulation.engine.step(simulation.act(tensordict["action"]))
        # Images and facts are of the same moment: one need not wait for the other.
        images = self.begin_look()
        moment = simulation.observe()
        out = self._tensordict(moment, None, images)
        # TorchRL fills in ``done``.
        out["terminated"] = moment.terminated.unsqueeze(-1)
        out["truncated"] = moment.truncated.unsqueeze(-1)
        out["reward"] = moment.reward.unsqueeze(-1).float()
        return out

    def begin_look(self, ids: Tensor | None = None) -> Callable[[], dict[str, Tensor]]:
        """Begin to take images, in a thread where there are CPUs; the returned function waits."""
        if self._aside is not None:
            return self._aside.submit(self._observer.look, ids).result
        images = self._observer.look(ids)
        return lambda: images

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulation.reseed(seed)

    def _tensordict(
        self,
        moment: StepResult,
        ids: Tensor | None,
        images: Callable[[], dict[str, Tensor]] = dict,
    ) -> TensorDict:
        """What is observed; images are renewed in environments ``ids`` (``None``: in all)."""
        self.moment = moment
        out = {
            "facts": {name: fact.unsqueeze(-1) for name, fact in moment.facts.items()},
            "terms": {name: t.unsqueeze(-1).float() for name, t in moment.terms.items()},
            "potential": moment.potential.unsqueeze(-1).float(),
            "steps": moment.steps.unsqueeze(-1),
            **self._observer(moment.signals, ids, images()),
        }
        return TensorDict(out, batch_size=self.batch_size)
