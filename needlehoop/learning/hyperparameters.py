"""What PPO is told; its values are in ``conf/algo/ppo.yaml``."""

from __future__ import annotations

from dataclasses import dataclass

from needlehoop.learning.networks import HeadConfig


@dataclass(frozen=True)
class PpoConfig:
    """Values in ``conf/algo/ppo.yaml``."""

    horizon: int
    """Steps of each environment after which an advantage is cut off and the value stands in for
    the rest."""
    minibatch: int
    shards: int
    """Parts of the agent's work on a minibatch that threads do side by side."""
    epochs: int
    """Passes over a buffer."""
    learning_rate: float
    """At the start; falls linearly to nothing."""
    gamma: float
    lam: float
    """GAE's lambda."""
    beta: float
    """Weight of the entropy; constant."""
    epsilon: float
    """Clipping of probability ratios and value moves; falls linearly to ``epsilon_end``."""
    epsilon_end: float
    value_coefficient: float
    clip_value: bool
    """Whether a value may move no further than epsilon per buffer."""
    network: HeadConfig
    warmup: int = 0
    """Buffers, in a run that begins with another's agent, from which the value function alone
    learns; runs older than it have none."""
    buffer: int | None = None
    """Steps of all environments that are collected before they are learnt from; ``None``: one
    horizon of each. Runs older than it have none."""

    def __post_init__(self) -> None:
        for key in ("horizon", "minibatch", "shards", "epochs"):
            if getattr(self, key) < 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be at least 1")
        if self.buffer is not None and self.buffer < 1:
            raise ValueError(f"algo.buffer: {self.buffer} must be at least 1, or null")
        if self.warmup < 0:
            raise ValueError(f"algo.warmup: {self.warmup} is negative")
        for key in ("learning_rate", "epsilon", "epsilon_end", "value_coefficient"):
            if not getattr(self, key) > 0:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be positive")
        for key in ("gamma", "lam"):
            if not 0 <= getattr(self, key) <= 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be between 0 and 1")
        if not self.beta >= 0:
            raise ValueError(f"algo.beta: {self.beta} must not be negative")


@dataclass(frozen=True)
class DaggerConfig:
    """Values in ``conf/algo/dagger.yaml``; a buffer holds ``num_envs * horizon`` steps."""

    kind: str
    """``dagger``; what tells these values from PPO's."""
    horizon: int
    """Steps of each environment per buffer."""
    memory: int
    """Frames that are learnt from, the newest; each is as large as its images."""
    minibatch: int
    shards: int
    """Parts of the agent's work on a minibatch that threads do side by side."""
    minibatches: int
    """After each buffer, drawn from all frames in memory."""
    learning_rate: float
    """At the start; falls to nothing as half a cosine."""
    bend: float
    """Error, in units of the action, at which the loss turns from square to straight."""
    jaw: float
    """Weight of the jaw's error; that of the motion's is 1."""
    noise: float
    """Of the strongest noise on an episode that the expert flies, in units of the action."""
    handover: float
    """Share of the steps after which the learner flies every episode that begins; before, it
    flies more and more of them."""
    network: HeadConfig

    def __post_init__(self) -> None:
        for key in ("horizon", "memory", "minibatch", "shards", "minibatches"):
            if getattr(self, key) < 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be at least 1")
        for key in ("learning_rate", "bend", "jaw", "handover"):
            if not getattr(self, key) > 0:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be positive")
        if not self.noise >= 0:
            raise ValueError(f"algo.noise: {self.noise} must not be negative")
