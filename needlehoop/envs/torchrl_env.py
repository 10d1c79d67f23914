"""A task as a batched TorchRL environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from needlehoop.envs.build import build
from needlehoop.envs.observer import Observer, vectors
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Moment
from needlehoop.envs.workers import Workers
from needlehoop.runs.machine import available_cpus


class TorchRLEnv(EnvBase):
    """``num_envs`` environments in lockstep, batch size ``(num_envs,)``.

    Keys: ``("pixels", <camera>)`` uint8 ``(n, frame_stack * channels, h, w)``; optionally
    ``proprio`` float32 ``(n, 8)`` (six joints, jaw, jaw command), ``signals`` and ``told``
    float32; for logging ``("facts", <name>)`` bool, ``("terms", <name>)`` and ``potential``
    float32 and ``steps`` int64, all ``(n, 1)``. ``action`` float32 ``(n, 5)`` in [-1, 1],
    ``(n, 7)`` with ``control=pose``. Success terminates; the time limit truncates.

    ``snapshot`` and ``restore`` carry a run on, bit for bit, in another process.

    Args:
        settings: what to build.
        first_env: index of the first environment among all that share the seed.
        stagger: whether the first episodes are cut off at evenly spread times, so that
            environments in lockstep are not all at the same stage of theirs.

    Raises:
        ValueError: settings that do not go together, by key.
    """

    def __init__(self, settings: Settings, first_env: int = 0, stagger: bool = False):
        self.settings, self._stagger = settings, stagger
        self.simulation = build(settings, first_env)
        """The simulation inside: signals, state, engine."""
        self._observer = Observer(self.simulation)
        self.workers = Workers(settings.engine.threads or available_cpus())
        self._is_restored = False
        n = settings.num_envs
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([n]))
        size, episode = settings.image_size, settings.episode
        column = torch.Size((n, 1))
        self.action_spec = Bounded(
            -1.0, 1.0, shape=torch.Size((n, episode.action_size)), dtype=torch.float32
        )
        self.reward_spec = Unbounded(shape=column)
        moment = self.simulation.reset()
        # Reading the names consumed each environment's first episode: give it back.
        self.simulation.reseed(settings.seed)
        observed = Composite(shape=(n,))
        if settings.cameras:
            pixels = Composite(shape=(n,))
            for name, channels in settings.image_channels.items():
                shape = torch.Size((n, channels, size, size))
                pixels[name] = Bounded(0, 255, shape=shape, dtype=torch.uint8)
            observed["pixels"] = pixels
        for name, length in vectors(settings.definition, settings.obs).items():
            observed[name] = Unbounded(shape=torch.Size((n, length)))
        facts, terms, ends = (Composite(shape=(n,)) for _ in range(3))
        for flags, names in ((facts, moment.facts), (ends, ("done", "terminated", "truncated"))):
            for name in names:
                flags[name] = Binary(1, shape=column, dtype=torch.bool)
        for name in moment.terms:
            terms[name] = Unbounded(shape=column)
        observed["facts"], observed["terms"] = facts, terms
        observed["potential"] = Unbounded(shape=column)
        observed["steps"] = Unbounded(shape=column, dtype=torch.int64)
        self.observation_spec, self.done_spec = observed, ends

    def progress(self, done: float) -> None:
        """Say which share of the training is done: ``disturb.ramp`` follows it.

        It counts for episodes that begin from now on.
        """
        wrong, ramp = self.simulation.disturbance, self.settings.disturb.ramp
        if wrong is not None:
            wrong.level = min(1.0, done / ramp) if ramp > 0 else 1.0

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides what comes next, as tensors and numbers."""
        return {"simulation": self.simulation.snapshot(), "observer": dict(self._observer.pixels)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot`` of an environment with the same settings.

        The next full reset begins no episode: it returns those under way as they stood.
        """
        self.simulation.restore(snapshot["simulation"])
        self._observer.pixels = dict(snapshot["observer"])
        self._is_restored = True

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDict:
        asked = None if tensordict is None else tensordict.get("_reset", None)
        no = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        ends = {"done": no, "terminated": no.clone(), "truncated": no.clone()}
        if self._is_restored and (asked is None or bool(asked.all())):
            self._is_restored = False
            return self._tensordict(self.simulation.look(), ends, no.nonzero().flatten())
        mask = None if asked is None else asked.reshape(self.batch_size[0])
        first = self.simulation.state is None
        if first:
            self._observer.pixels = {}
        self.simulation.begin(mask, stagger=self._stagger)
        fresh = None if mask is None or first else mask.nonzero().flatten()
        images = self.workers.begin(lambda: self._observer.look(fresh))
        return self._tensordict(self.simulation.look(), ends, fresh, images)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        simulation = self.simulation
        simulation.engine.step(simulation.act(tensordict["action"]))
        # Images and facts are of the same moment: one need not wait for the other.
        images = self.workers.begin(self._observer.look)
        moment = simulation.observe()
        terminated, truncated = moment.terminated.unsqueeze(-1), moment.truncated.unsqueeze(-1)
        ends = {
            "done": terminated | truncated,
            "terminated": terminated,
            "truncated": truncated,
            "reward": moment.reward.unsqueeze(-1).float(),
        }
        return self._tensordict(moment, ends, None, images)

    def step_and_reset(self, action: Tensor) -> tuple[TensorDict, TensorDict]:
        """A step of every environment, and new episodes where it ended theirs.

        Returns:
            What came of the action ``(n, action_size)``, and what is there now. They share
            what did not change.
        """
        after = self._step(TensorDict({"action": action}, self.batch_size))
        done = after["done"]
        if not bool(done.any()):
            return after, after
        return after, self._reset(TensorDict({"_reset": done}, self.batch_size))

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.simulation.reseed(seed)

    def _tensordict(
        self,
        moment: Moment,
        rest: dict[str, Any],
        ids: Tensor | None,
        images: Callable[[], dict[str, Tensor]] = dict,
    ) -> TensorDict:
        """All keys; images are renewed in environments ``ids`` (in all by default)."""
        out = {
            "facts": {name: fact.unsqueeze(-1) for name, fact in moment.facts.items()},
            "terms": {name: t.unsqueeze(-1).float() for name, t in moment.terms.items()},
            "potential": moment.potential.unsqueeze(-1).float(),
            "steps": moment.steps.unsqueeze(-1),
            **self._observer(moment.signals, ids, images()),
            **rest,
        }
        return TensorDict(out, batch_size=self.batch_size)
