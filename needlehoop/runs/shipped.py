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

_RUNS = {
    "agent": "results/table2/dep_front+seg_side/human/seed0",
    "agent_reach": "results/reach/dep_front+seg_side/expert/seed0",
    "agent_peg_transfer": "results/peg_transfer/dep_front+seg_side/expert/seed0",
}
"""Runs whose agents are shipped: in an installed package under these names, or in a checkout."""


def _shipped(name: str) -> Path:
    inside = _PACKAGE / name
    places = (inside, _PACKAGE.parent / _RUNS[name])
    return next((place for place in places if place.is_dir()), inside)


AGENT = _shipped("agent")
"""A run's folder: the agent that is flown if none is named."""


def agent_of(task: str) -> Path:
    """The shipped agent of a task or one of its variants, ``reach`` or ``reach/wide``."""
    name = f"agent_{task.partition('/')[0]}"
    return _shipped(name) if name in _RUNS else AGENT
