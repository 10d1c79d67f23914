"""From a run's folder to its policy."""

from __future__ import annotations

from pathlib import Path

from needlehoop import config
from needlehoop.learning.evaluate import load_agent
from needlehoop.learning.job import pick_device
from needlehoop.learning.policy import Policy
from needlehoop.learning.weights import actor_of, build_actor, read_config, read_weights
from needlehoop.runs.files import POLICY
from needlehoop.runs.run import Run


def policy_of(run: str | Path, device: str) -> Policy:
    """A run's policy, from ``policy.safetensors`` or else from its checkpoint.

    Args:
        run: its folder; or a ``policy.safetensors``, which needs nothing beside it.
        device: ``auto``, ``cpu``, ``cuda`` or ``cuda:<k>``.

    Raises:
        ValueError: neither of them there, or a damaged one.
    """
    where, chosen = Path(run), pick_device(device)
    weights = where / POLICY if where.is_dir() else where
    if where.is_dir() and not weights.exists():
        opened = Run.open(where)
        job = config.job(opened.config())
        return Policy(job, actor_of(load_agent(opened, job, chosen)))
    job = config.job(read_config(weights))
    actor = build_actor(job, chosen)
    read_weights(weights, actor)
    return Policy(job, actor)
