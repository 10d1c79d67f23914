"""The agent: TorchRL's policy and value operators on our networks."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.data import Composite
from torchrl.modules import (
    ActorValueOperator,
    IndependentNormal,
    ProbabilisticActor,
    ValueOperator,
)

from needlehoop.envs.observer import VECTORS
from needlehoop.learning.encoder import Encoder, EncoderConfig, Fold
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk, Value


class Agent(TensorDictModuleBase):
    """Policy and value function over a shared trunk.

    Called with a TensorDict of observations, it writes the folded images, ``action`` (sampled or
    the mean, as TorchRL's exploration type says), its log-probability and ``state_value``.
    ``actor`` does the same without the value, for which nothing but observations is needed.

    Args:
        observed: the environment's observation spec, batch size ``(n,)``.
        actions: length of the action.
        encoder: of every camera.
        heads: trunk and heads.
        dtype: of the convolutions.

    Raises:
        ValueError: images that do not fit the encoder, or a fact that the environment lacks.
    """

    def __init__(
        self,
        observed: Composite,
        actions: int,
        encoder: EncoderConfig,
        heads: HeadConfig,
        dtype: torch.dtype,
    ):
        super().__init__()
        keys = set(observed.keys())
        pixels = observed["pixels"] if "pixels" in keys else Composite()
        images = {str(name): spec.shape[1:] for name, spec in pixels.items()}
        vectors = {name: observed[name].shape[-1] for name in VECTORS if name in keys}
        fold = Fold(encoder.stem)
        folds: list[Any] = [
            TensorDictModule(fold, [("pixels", name)], [("folded", name)]) for name in images
        ]
        self.fold: Any = TensorDictSequential(*folds)
        hidden = ("hidden",) if heads.shared else ("hidden", "hidden_value")
        seen = [*(("folded", name) for name in images), *vectors]
        trunks = [Trunk(images, vectors, encoder, heads, dtype) for _ in hidden]
        trunk_modules: list[Any] = [
            TensorDictModule(one, in_keys=seen, out_keys=[key])
            for one, key in zip(trunks, hidden, strict=True)
        ]
        trunk = TensorDictSequential(*trunk_modules)
        gaussian = Gaussian(heads.hidden, actions, heads.sigma)
        policy = ProbabilisticActor(
            TensorDictModule(gaussian, in_keys=["hidden"], out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        facts = [("facts", name) for name in heads.told]
        known = sorted(map(str, observed["facts"].keys())) if facts else []
        for name in heads.told:
            if name not in known:
                raise ValueError(
                    f"algo.network.told: {name!r} is unknown; choose from {', '.join(known)}"
                )
        value = Value(heads.hidden, len(facts))
        self.operator = ActorValueOperator(
            trunk, policy, ValueOperator(value, in_keys=[hidden[-1], *facts])
        )
        # The same modules once more, in a tuple so that they are not registered twice.
        self._plain = (fold, trunks, gaussian, value)
        self._images, self._vectors = len(images), len(vectors)
        self.seen_keys = [*seen, *facts]
        self.in_keys = [*(("pixels", name) for name in images), *vectors, *facts]
        self.out_keys = [*self.fold.out_keys, *self.operator.out_keys]

    @property
    def actor(self) -> TensorDictModuleBase:
        """The policy alone, from the same weights."""
        policy: Any = self.operator.get_policy_operator()
        return TensorDictSequential(self.fold, policy)

    def computing(self) -> Agent:
        """A copy with the encoders' weights in the type that they compute in.

        It gives the same outputs without converting a weight; ``follow`` brings it up to date.
        """
        copied = deepcopy(self)
        for module in copied.modules():
            if isinstance(module, Encoder):
                module.to(module.dtype)
        return copied

    @torch.no_grad()
    def follow(self, agent: Agent) -> None:
        """Take over another agent's weights and statistics, in the types of one's own."""
        pairs = zip(
            (*self.parameters(), *self.buffers()),
            (*agent.parameters(), *agent.buffers()),
            strict=True,
        )
        for own, other in pairs:
            own.copy_(other)

    @property
    def encoders(self) -> list[Encoder]:
        """One per camera; those of the value function's own trunk after the policy's."""
        _, trunks, *_ = self._plain
        found: list[Any] = [encoder for trunk in trunks for encoder in trunk.encoders.values()]
        return found

    def prepare(self, *observed: Tensor) -> list[Tensor]:
        """Observations in the order of ``in_keys``, images folded: that of ``seen_keys``."""
        fold, *_ = self._plain
        return [*map(fold, observed[: self._images]), *observed[self._images :]]

    def conclude(
        self, features: Sequence[Tensor], rest: Sequence[Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """``loc``, ``scale`` and ``state_value`` from what the encoders make of images.

        The same as in ``forward``, of plain tensors: threads with a few rows each would mostly
        wait for one another's TensorDicts.

        Args:
            features: in the order of ``encoders``.
            rest: of ``seen_keys``, what are not images.
        """
        _, trunks, gaussian, value = self._plain
        vectors, facts = rest[: self._vectors], rest[self._vectors :]
        hidden = [
            trunk.merge(features[i * self._images : (i + 1) * self._images], vectors)
            for i, trunk in enumerate(trunks)
        ]
        return *gaussian(hidden[0]), value(hidden[-1], *facts)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.operator(self.fold(tensordict))
