"""A run's settings as they are typed on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def typed_settings(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Settings as ``algo.gamma``, as they are typed on the command line."""
    pairs = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            pairs += typed_settings(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", _typed(value)))
    return pairs


def _typed(value: Any) -> str:
    """A value as Hydra takes it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return f"[{','.join(map(_typed, value))}]"
    return str(value)
