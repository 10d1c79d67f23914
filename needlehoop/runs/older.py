"""Configs of runs that began before a setting was there."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

_MEANT: tuple[tuple[str, Any], ...] = (
    ("engine.renderer", "tracer"),
    ("episode.success", "thread"),
    ("obs.told", []),
    ("algo.network.told", []),
)
"""What a run did that says nothing of a setting, by key."""

_OF_TRAINING = (("init", None), ("weights", "float32"))
_OF_PPO = (("algo.warmup", 0), ("algo.finetune", 1.0), ("algo.buffer", None))

_OF_KIND: Mapping[str, tuple[tuple[str, Any], ...]] = {
    # Its lengths were in metres.
    "human": (("reward.unit", 1.0), ("reward.name", None)),
    "sparse": (("reward.name", None),),
    "vlm_text": (("reward.sample", 1), ("reward.unit", None), ("reward.name", None)),
    "vlm_img": (("reward.sample", 1), ("reward.unit", None), ("reward.name", None)),
    "file": (("reward.unit", None), ("reward.name", None)),
    "python": (("reward.name", None),),
}
"""The same by the kind of its reward."""


def completed(config: Mapping[str, Any]) -> dict[str, Any]:
    """A run's config with what was meant by the settings that it lacks; the argument is kept.

    A group that the config has not got, or that is no group, is left as it is.
    """
    values = deepcopy(dict(config))
    reward = values.get("reward")
    kind = reward.get("kind") if isinstance(reward, dict) else None
    algo = values.get("algo")
    more: list[tuple[str, Any]] = list(_OF_KIND.get(kind, ())) if isinstance(kind, str) else []
    if isinstance(algo, dict):
        more += _OF_TRAINING if "kind" in algo else (*_OF_TRAINING, *_OF_PPO)
    for key, meant in (*_MEANT, *more):
        *groups, name = key.split(".")
        group: Any = values
        for one in groups:
            group = group.get(one) if isinstance(group, dict) else None
        if isinstance(group, dict):
            group.setdefault(name, meant)
    return values
