"""Trials of a controller over many episodes, in batches of environments."""

from __future__ import annotations

from dataclasses import replace

from needlehoop.controllers import controller
from needlehoop.rollout import Outcome, join, run_episodes
from needlehoop.settings import Settings, build

_BATCH = 200


def run_trials(settings: Settings, who: str, episodes: int) -> Outcome:
    """One first episode in each of ``episodes`` environments of the settings' seed.

    Args:
        settings: environment; ``num_envs`` and cameras are ignored.
        who: a name from ``controllers.CONTROLLERS``.
        episodes: how many; episode ``i`` is the same however many there are.

    Raises:
        ValueError: fewer than one episode, or an unknown controller.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes} must be at least 1")
    outcomes = []
    for first in range(0, episodes, _BATCH):
        chunk = replace(settings, num_envs=min(_BATCH, episodes - first), cams=())
        simulation, _ = build(chunk, first_env=first)
        outcomes.append(run_episodes(simulation, controller(who, chunk)))
    return join(outcomes)
