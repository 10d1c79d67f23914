"""Hyperparameters of PPO and DAgger, as in ``conf/algo``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from needlehoop.config.strict import Count, Number, OneOf, Positive, Range, Share
from needlehoop.learning.networks import HeadConfig
from needlehoop.runs.files import DAGGER

Horizon = Annotated[int, Range(1, 100_000)]
Shards = Annotated[int, Range(1, 1024)]
Rate = Annotated[float, Range(0.0, 10.0, above=True)]


@dataclass(frozen=True)
class PpoConfig:
    """Values in ``conf/algo/ppo.yaml``."""

    horizon: Horizon
    """Steps of an environment after which an advantage is cut off; the value replaces the rest."""
    minibatch: Count
    shards: Shards
    """Parts of the agent's work on a minibatch that threads do side by side."""
    epochs: Annotated[int, Range(1, 1000)]
    """Passes over a buffer."""
    learning_rate: Rate
    """At the start; falls linearly to nothing."""
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
    network: HeadConfig
    warmup: Number = 0
    """Buffers at the start of a run with ``init=`` in which only the value function learns."""
    finetune: Annotated[float, Range(0.0, 1.0, above=True)] = 1.0
    """Share of the learning rate with which its policy learns afterwards."""
    buffer: Count | None = None
    """Steps of all environments that are collected before they are learnt from; ``None``: one
    horizon of each."""


@dataclass(frozen=True)
class DaggerConfig:
    """Values in ``conf/algo/dagger.yaml``; a buffer holds ``num_envs * horizon`` steps."""

    kind: Annotated[str, OneOf(DAGGER)]
    """What tells these values from PPO's."""
    horizon: Horizon
    """Steps of each environment per buffer."""
    memory: Annotated[int, Range(1, 10_000_000)]
    """Newest frames, which are learnt from; each is as large as its images."""
    minibatch: Count
    shards: Shards
    """Parts of the agent's work on a minibatch that threads do side by side."""
    minibatches: Annotated[int, Range(1, 1_000_000)]
    """After each buffer, drawn from all frames in memory."""
    learning_rate: Rate
    """At the start; falls to nothing as half a cosine."""
    bend: Positive
    """Error, in units of the action, at which the loss turns from square to straight."""
    jaw: Positive
    """Weight of the jaw's error; that of the motion's is 1."""
    noise: Annotated[float, Range(0.0, 100.0)]
    """Strongest noise on an episode in which the expert acts, in units of the action."""
    handover: Positive
    """Share of the steps after which the learner acts in every new episode. Before, its part of
    the episodes grows."""
    network: HeadConfig
