"""Does the physics hold together under random actions at full amplitude?

    python benchmarks/stability.py 1000 num_envs=80 episode.grasp=friction

The words are the number of episodes and settings of an environment.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np
import torch

from needlehoop.engines.engine import Engine
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings, compose_settings

_TABLE = 0.15
"""Half-width of the square about the origin that counts as the table area, m."""
_DEEP = 1e-3
"""Penetration that counts, m."""


@dataclass(frozen=True)
class Stability:
    """Counts over control steps of random episodes; ``deepest`` in m."""

    episodes: int
    steps: int
    not_finite: int
    outside_table: int
    below_table: int
    deep_contacts: int
    deepest: float


def shake(settings: Settings, episodes: int) -> Stability:
    """Run random episodes whose actions are all -1 or 1, and count what goes wrong.

    Args:
        settings: environment; cameras are ignored.
        episodes: at least this many, in whole batches of ``num_envs``.

    Raises:
        RuntimeError: MuJoCo itself reports a diverged simulation.
    """
    simulation = build(replace(settings, cams=()))
    engine = simulation.engine
    generator = torch.Generator().manual_seed(settings.seed)
    n, size = settings.num_envs, settings.episode.action_size
    counts = np.zeros(4, dtype=np.int64)
    deepest, finished, steps = 0.0, 0, 0
    simulation.reset()
    action = torch.zeros(n, size)
    while finished < episodes:
        # Held for a few steps: jitter about a point shakes less than long full pushes.
        if steps % 5 == 0:
            action = 2.0 * torch.randint(0, 2, (n, size), generator=generator) - 1.0
        moment = simulation.step(action)
        if bool(moment.facts["diverged"].any()):
            raise RuntimeError("MuJoCo reports a simulation that diverged")
        steps += 1
        needle = np.stack((moment.signals.pickup_point, moment.signals.needle_tip), 1)
        finite, depth = _inspect(engine)
        counts += [
            int((~finite).sum()),
            int((np.abs(needle[..., :2]) > _TABLE).any((1, 2)).sum()),
            int((needle[..., 2] < 0.0).any(1).sum()),
            int((depth > _DEEP).sum()),
        ]
        deepest = max(deepest, float(depth.max()))
        over = moment.terminated | moment.truncated
        finished += int(over.sum())
        if bool(over.any()):
            simulation.reset(over)
    return Stability(finished, steps * n, *map(int, counts), deepest=deepest)


def _inspect(engine: Engine) -> tuple[np.ndarray, np.ndarray]:
    """Whether each environment's state is finite, and how deep its deepest contact is, m; ``(n,)``.

    Without a contact: 0.
    """
    finite, depth = np.zeros(engine.num_envs, dtype=bool), np.zeros(engine.num_envs)
    for env in range(engine.num_envs):
        data = engine.data(env)
        finite[env] = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
        depth[env] = -data.contact.dist.min(initial=0.0)
    return finite, depth


if __name__ == "__main__":
    episodes, *words = sys.argv[1:]
    print(shake(compose_settings(words), int(episodes)))
