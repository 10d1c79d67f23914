"""Folders that come with the package: settings, recordings, a trained agent."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def _shipped(name: str, beside: str) -> Path:
    """A folder inside an installed package, or under another name beside it in a checkout."""
    inside, checkout = _PACKAGE / name, _PACKAGE.parent / beside
    return checkout if checkout.is_dir() and not inside.is_dir() else inside


CONF = _shipped("conf", "conf")
"""Hydra's configs."""

RECORDINGS = _PACKAGE / "recordings"
"""What models answered, each in a folder of its own."""

AGENTS = {
    "agent": "results/agents/dep_front+seg_side/human/seed0",
    "agent_reach": "results/reach/dep_front+seg_side/expert/seed0",
    "agent_peg_transfer": "results/peg_transfer/dep_front+seg_side/expert/seed0",
    "agent_handover": "results/handover/rgb_front+rgb_side/expert/seed0",
}
"""Runs whose agents are shipped: in an installed package under these names, or in a checkout.
``setup.py`` reads them here."""

AGENT = _shipped("agent", AGENTS["agent"])
"""A run's folder: the agent that is flown if none is named."""


def agent_of(task: str) -> Path:
    """The shipped agent of a task or one of its variants, ``reach`` or ``reach/wide``."""
    name = f"agent_{task.partition('/')[0]}"
    return _shipped(name, AGENTS[name]) if name in AGENTS else AGENT
