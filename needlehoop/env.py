"""The task as a batched TorchRL environment."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from needlehoop.settings import Settings, build
from needlehoop.signals import Signals, proprio
from needlehoop.simulation import Moment, Simulation

FACTS = ("grasped", "lifted", "touched", "threaded", "cheat")

STATE_SIGNALS = (
    "tool_midpoint",
    "pickup_point",
    "needle_tip",
    "goal",
    "lift_position",
    "needle_quat",
    "joints",
    "jaw",
    "jaw_command",
    "grasped",
    "lifted",
)
"""What ``signals`` concatenates: enough to do the task without eyes."""


class NeedleHoopEnv(EnvBase):
    """``num_envs`` environments in lockstep, batch size ``(num_envs,)``.

    Keys: ``("pixels", <camera>)`` uint8 ``(n, channels, h, w)``; optionally ``proprio``
    float32 ``(n, 8)`` (six joints, jaw, jaw command) and ``signals`` float32; for logging
    ``("facts", <name>)`` bool and ``("terms", <name>)``, ``potential`` float32, all
    ``(n, 1)``. ``action`` float32 ``(n, 5)`` in [-1, 1], ``(n, 7)`` with ``control=pose``.
    Success terminates; the time limit truncates.

    Args:
        settings: what to build.

    Raises:
        ValueError: settings that do not go together, by key.
    """

    def __init__(self, settings: Settings):
        self.settings = settings
        self._simulation, self._imager = build(settings)
        n = settings.num_envs
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([n]))
        self._pixels: dict[str, Tensor] = {}
        self._set_specs(settings)

    @property
    def simulation(self) -> Simulation:
        """The simulation inside: signals, state, engine."""
        return self._simulation

    def _set_specs(self, settings: Settings) -> None:
        n, size, episode = settings.num_envs, settings.image_size, settings.episode
        column = torch.Size((n, 1))
        self.action_spec = Bounded(
            -1.0, 1.0, shape=torch.Size((n, episode.action_size)), dtype=torch.float32
        )
        self.reward_spec = Unbounded(shape=column)
        moment = self._simulation.reset()
        # Reading the names consumed each environment's first episode: give it back.
        self._simulation.reseed(settings.seed)
        observed = Composite(shape=(n,))
        if settings.cameras:
            pixels = Composite(shape=(n,))
            for camera in settings.cameras:
                channels = settings.renderings[camera.rendering].channels
                shape = torch.Size((n, channels, size, size))
                pixels[camera.name] = Bounded(0, 255, shape=shape, dtype=torch.uint8)
            observed["pixels"] = pixels
        if settings.obs.proprio:
            observed["proprio"] = Unbounded(shape=proprio(moment.signals).shape)
        if settings.obs.signals:
            observed["signals"] = Unbounded(shape=_state(moment.signals).shape)
        observed["facts"] = Composite(
            {name: Binary(1, shape=column, dtype=torch.bool) for name in FACTS}, shape=(n,)
        )
        observed["terms"] = Composite(
            {name: Unbounded(shape=column) for name in moment.terms}, shape=(n,)
        )
        observed["potential"] = Unbounded(shape=column)
        self.observation_spec = observed
        self.done_spec = Composite(
            {
                name: Binary(1, shape=column, dtype=torch.bool)
                for name in ("done", "terminated", "truncated")
            },
            shape=(n,),
        )

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        mask = None
        asked = None if tensordict is None else tensordict.get("_reset", None)
        if asked is not None:
            mask = asked.reshape(self.batch_size[0])
        first = self._simulation.state is None
        moment = self._simulation.reset(mask)
        self._look(None if mask is None or first else mask.nonzero().flatten())
        no = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        ends = {"done": no, "terminated": no.clone(), "truncated": no.clone()}
        return self._tensordict(moment, ends)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        moment = self._simulation.step(tensordict["action"])
        self._look(None)
        terminated, truncated = moment.terminated.unsqueeze(-1), moment.truncated.unsqueeze(-1)
        ends = {
            "done": terminated | truncated,
            "terminated": terminated,
            "truncated": truncated,
            "reward": moment.reward.unsqueeze(-1).float(),
        }
        return self._tensordict(moment, ends)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._simulation.reseed(seed)

    def _look(self, ids: Tensor | None) -> None:
        """Renew the images of environments ``ids``; of all by default."""
        if not self.settings.cams or (ids is not None and not len(ids)):
            return
        images = self._imager(self._simulation.engine.render(ids))
        if ids is None:
            self._pixels = images
            return
        # The previous images are in somebody's hands: new tensors, not new contents.
        self._pixels = {name: image.clone() for name, image in self._pixels.items()}
        for name, image in images.items():
            self._pixels[name][ids] = image

    def _tensordict(self, moment: Moment, rest: dict[str, Tensor]) -> TensorDict:
        signals = moment.signals
        facts = {name: getattr(signals, name) for name in FACTS if name != "cheat"}
        facts["cheat"] = moment.cheat
        out = {
            "facts": {name: fact.unsqueeze(-1) for name, fact in facts.items()},
            "terms": {name: t.unsqueeze(-1).float() for name, t in moment.terms.items()},
            "potential": moment.potential.unsqueeze(-1).float(),
            **rest,
        }
        if self.settings.cams:
            out["pixels"] = dict(self._pixels)
        if self.settings.obs.proprio:
            out["proprio"] = proprio(signals)
        if self.settings.obs.signals:
            out["signals"] = _state(signals)
        return TensorDict(out, batch_size=self.batch_size)


def _state(signals: Signals) -> Tensor:
    columns = []
    for name in STATE_SIGNALS:
        value = getattr(signals, name).float()
        columns.append(value if value.ndim == 2 else value.unsqueeze(-1))
    return torch.cat(columns, -1)
