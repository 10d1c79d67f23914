"""What PPO is told; its values are in ``conf/algo/ppo.yaml``."""

from __future__ import annotations

from dataclasses import dataclass

from needlehoop.learning.networks import HeadConfig


@dataclass(frozen=True)
class PpoConfig:
    """Values in ``conf/algo/ppo.yaml``; a buffer holds ``num_envs * horizon`` steps."""

    horizon: int
    """Steps of each environment per buffer."""
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

    def __post_init__(self) -> None:
        for key in ("horizon", "minibatch", "shards", "epochs"):
            if getattr(self, key) < 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be at least 1")
        for key in ("learning_rate", "epsilon", "epsilon_end", "value_coefficient"):
            if not getattr(self, key) > 0:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be positive")
        for key in ("gamma", "lam"):
            if not 0 <= getattr(self, key) <= 1:
                raise ValueError(f"algo.{key}: {getattr(self, key)} must be between 0 and 1")
        if not self.beta >= 0:
            raise ValueError(f"algo.beta: {self.beta} must not be negative")
