"""The agent: TorchRL's policy and value operators on our networks."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torchrl.data import Composite
from torchrl.modules import (
    ActorValueOperator,
    IndependentNormal,
    ProbabilisticActor,
    ValueOperator,
)

from needlehoop.learning.encoder import EncoderConfig, Fold
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk, Value

VECTORS = ("proprio", "signals")
"""Observations that are not images, in the order in which the trunk reads them."""


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
        folds: list[Any] = [
            TensorDictModule(Fold(encoder.stem), [("pixels", name)], [("folded", name)])
            for name in images
        ]
        self.fold: Any = TensorDictSequential(*folds)
        trunks: list[Any] = [
            TensorDictModule(
                Trunk(images, vectors, encoder, heads, dtype),
                in_keys=[*(("folded", name) for name in images), *vectors],
                out_keys=[key],
            )
            for key in (("hidden",) if heads.shared else ("hidden", "hidden_value"))
        ]
        trunk = TensorDictSequential(*trunks)
        policy = ProbabilisticActor(
            TensorDictModule(
                Gaussian(heads.hidden, actions, heads.sigma),
                in_keys=["hidden"],
                out_keys=["loc", "scale"],
            ),
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
        value = ValueOperator(
            Value(heads.hidden, len(facts)), in_keys=[*trunks[-1].out_keys, *facts]
        )
        self.operator = ActorValueOperator(trunk, policy, value)
        self.in_keys = [*(("pixels", name) for name in images), *vectors, *facts]
        self.out_keys = [*self.fold.out_keys, *self.operator.out_keys]

    @property
    def actor(self) -> TensorDictModuleBase:
        """The policy alone, from the same weights."""
        policy: Any = self.operator.get_policy_operator()
        return TensorDictSequential(self.fold, policy)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.operator(self.fold(tensordict))
