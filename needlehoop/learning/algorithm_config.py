"""Settings of the methods of training: a dataclass for each file of ``conf/algo``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from needlehoop.config import strict
from needlehoop.config.strict import Count, Number, OneOf, Positive, Range, Share
from needlehoop.learning.networks import HeadConfig
from needlehoop.runs.files import DAGGER, PPO, SAC


@dataclass(frozen=True, kw_only=True)
class AlgorithmConfig:
    """What every file of ``conf/algo`` has."""

    kind: str
    """Selects the algorithm."""
    horizon: Annotated[int, Range(1, 100_000)]
    """Steps of each environment per buffer; of PPO also those that an advantage looks ahead."""
    buffer: Count | None = None
    """Steps in a buffer, over all environments; ``None``: ``num_envs * horizon``."""
    minibatch: Count
    learning_rate: Annotated[float, Range(0.0, 10.0, above=True)]
    network: HeadConfig

    def __post_init__(self) -> None:
        # The others train the mean before the tanh, and would act after it.
        if self.network.squash != (self.kind == SAC):
            raise ValueError(
                "algo.network.squash: algo=sac alone squashes actions, and always does"
            )


@dataclass(frozen=True, kw_only=True)
class PpoConfig(AlgorithmConfig):
    """Values in ``conf/algo/ppo.yaml``."""

    kind: Annotated[str, OneOf(PPO)] = PPO
    epochs: Annotated[int, Range(1, 1000)]
    """Passes over a buffer."""
    gamma: Share
    lam: Share
    """GAE's lambda."""
    beta: Annotated[float, Range(0.0, 1e3)]
    """Weight of the entropy; constant."""
    epsilon: Annotated[float, Range(0.0, 1.0, above=True)]
    """Clipping of probability ratios and value moves; falls linearly to ``epsilon_end``."""
    epsilon_end: Annotated[float, Range(0.0, 1.0, above=True)]
    value_coefficient: Annotated[float, Range(0.0, 1e3, above=True)]
    clip_value: bool
    """Whether a value may move no further than epsilon per buffer."""
    warmup: Number = 0
    """Buffers at the start of a run with ``init=`` in which only the value function learns."""
    finetune: Annotated[float, Range(0.0, 1.0, above=True)] = 1.0
    """Share of the learning rate with which its policy learns afterwards."""


@dataclass(frozen=True, kw_only=True)
class MemoryConfig(AlgorithmConfig):
    """What algorithms have that learn from older steps too."""

    memory: Annotated[int, Range(1, 10_000_000)]
    """Newest steps, which are learnt from."""
    minibatches: Annotated[int, Range(1, 1_000_000)]
    """After each buffer, drawn from all steps in memory."""
    picture_shift: Annotated[int, Range(0, 64)] = 0
    """Most pixels by which an image is moved, up or down and to a side, whenever it is learnt
    from."""


@dataclass(frozen=True, kw_only=True)
class DaggerConfig(MemoryConfig):
    """Values in ``conf/algo/dagger.yaml``."""

    kind: Annotated[str, OneOf(DAGGER)]
    bend: Positive
    """Error, in units of the action, at which the loss turns from square to straight."""
    noise: Annotated[float, Range(0.0, 100.0)]
    """Strongest noise on an episode in which the expert acts, in units of the action."""
    handover: Positive
    """Share of the steps after which the learner acts in every new episode. Before, its part of
    the episodes grows."""


@dataclass(frozen=True, kw_only=True)
class SacConfig(MemoryConfig):
    """Values in ``conf/algo/sac.yaml``."""

    kind: Annotated[str, OneOf(SAC)]
    gamma: Share
    n_steps: Count
    """Steps whose rewards are summed before a critic judges the rest, within a buffer."""
    tau: Annotated[float, Range(0.0, 1.0, above=True)]
    """Share of the way that the targets follow after each minibatch."""
    alpha: Positive
    """Weight of the entropy at the start; it is learnt."""


CONFIGS = {PPO: PpoConfig, DAGGER: DaggerConfig, SAC: SacConfig}
"""By ``algo.kind``."""


def config_of(values: Any) -> AlgorithmConfig:
    """The group ``algo`` of a composed config."""
    settings = strict.structure(values, Mapping[str, Any], "algo")
    # Runs in results/ from before there were several methods are PPO's.
    kind = settings.get("kind", PPO)
    strict.check_names("algo.kind", [kind], [*CONFIGS])
    # Keys of such runs that no longer have an effect.
    fields = {key: value for key, value in settings.items() if key not in ("shards", "jaw")}
    return strict.structure(fields, CONFIGS[kind], "algo")
