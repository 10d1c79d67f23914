"""Folders that come with the package: settings, recordings, a trained agent."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]

CONF = next(
    (place for place in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if place.is_dir()),
    _PACKAGE / "conf",
)
"""Hydra's configs: inside an installed package, beside it in a checkout."""

RECORDINGS = _PACKAGE / "recordings"
"""What models answered, each in a folder of its own."""

_AGENT = "results/table2/dep_front+seg_side/human/seed0"

AGENT = next(
    (place for place in (_PACKAGE / "agent", _PACKAGE.parent / _AGENT) if place.is_dir()),
    _PACKAGE / "agent",
)
"""A run's folder: the agent that is flown if none is named."""
