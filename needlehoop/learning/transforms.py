"""TorchRL transforms that a training adds to its environments."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Transform

from needlehoop.envs.controllers import Perturbation, controller
from needlehoop.envs.settings import Settings

LABEL = "label"
"""Key of the expert's action ``(n, action_size)``, which the policy is to learn."""

EXPERT = "expert"
"""Key of the expert's action with noise added; what is carried out in the expert's episodes."""

LEARNER = "learner"
"""Key of whether the learner acts in this episode ``(n, 1)``, or else the expert."""


class Teacher(Transform):
    """An expert that labels every step, and acts in some of the episodes.

    Who acts in an episode is drawn when it begins. The learner's share grows from nothing to all.
    The expert acts under noise, so that it shows how to correct errors (``Perturbation``).

    ``noise``: the strongest. ``handover``: share of the training after which the learner acts in
    every new episode. ``seed``: decides who acts, and the noise.
    """

    def __init__(self, settings: Settings, noise: float, handover: float, seed: int):
        super().__init__(in_keys=[], out_keys=[LABEL, EXPERT, LEARNER])
        self._expert = controller(settings.definition.teacher, settings)
        self._handover, self._generator = handover, torch.Generator().manual_seed(seed)
        self._shape = (settings.num_envs, settings.episode.action_size)
        device = settings.engine.torch_device
        self._noise = Perturbation(*self._shape, noise, self._generator, device)
        self._learner = torch.zeros(settings.num_envs, dtype=torch.bool, device=device)
        self._acted = torch.zeros(self._shape, device=device)
        self._is_restored = False

    @property
    def _env(self) -> Any:
        return self.parent.base_env  # pyright: ignore[reportOptionalMemberAccess]

    def _show(self, into: TensorDictBase, fresh: Tensor | None = None) -> TensorDictBase:
        """Write the teacher's keys; the expert acts anew where ``fresh`` ``(n,)`` is true."""
        label = self._expert(self._env.moment.signals).float()
        if fresh is not None:
            acted = (label + self._noise(fresh).float()).clamp(-1.0, 1.0)
            self._acted = torch.where(fresh.unsqueeze(-1), acted, self._acted)
        return into.update(
            {LABEL: label, EXPERT: self._acted, LEARNER: self._learner.unsqueeze(-1)}
        )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._show(next_tensordict, torch.ones_like(self._learner))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        fresh = torch.ones_like(self._learner) if mask is None else mask.flatten()
        if self._is_restored and bool(fresh.all()):
            self._is_restored = False
            return self._show(tensordict_reset)
        share = min(1.0, self._env.done_share / self._handover)
        drawn = torch.rand(fresh.shape, generator=self._generator).to(fresh.device) < share
        self._learner = torch.where(fresh, drawn, self._learner)
        self._noise.begin(fresh)
        return self._show(tensordict_reset, fresh)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """With the teacher's keys."""
        spec, shape = observation_spec.clone(), torch.Size(self._shape)
        here, column = spec.device, torch.Size((shape[0], 1))
        for key in (LABEL, EXPERT):
            spec[key] = Unbounded(shape=shape, device=here)
        spec[LEARNER] = Binary(1, shape=column, dtype=torch.bool, device=here)
        return spec

    def get_extra_state(self) -> dict[str, Any]:
        """Everything that decides the next actions."""
        noise = {"drift": self._noise.drift, "strength": self._noise.strength}
        state = {"learner": self._learner, "acted": self._acted, **noise}
        return {**state, "generator": self._generator.get_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on from a ``get_extra_state``."""
        here = self._acted.device
        self._learner, self._acted = state["learner"].to(here), state["acted"].to(here)
        self._noise.drift, self._noise.strength = (
            state[name].to(here) for name in ("drift", "strength")
        )
        self._generator.set_state(state["generator"])
        self._is_restored = True


class Carry(Transform):
    """Puts the environment and torch's generator into a collector's ``state_dict``.

    The collector itself keeps the state of transforms only.
    """

    @property
    def _env(self) -> Any:
        return self.parent.base_env  # pyright: ignore[reportOptionalMemberAccess]

    def get_extra_state(self) -> dict[str, Any]:
        """The environment's state, and that of torch's generator."""
        return {"env": self._env.state_dict(), "rng": torch.get_rng_state()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on from a ``get_extra_state``."""
        self._env.load_state_dict(state["env"])
        torch.set_rng_state(state["rng"])
