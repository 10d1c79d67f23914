"""Trials of a controller over many episodes, in batches of environments."""

from __future__ import annotations

from dataclasses import replace

from needlehoop.envs.controllers import controller
from needlehoop.envs.rollout import Outcome, run_batches
from needlehoop.envs.settings import Settings

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
    blind = replace(settings, cams=())
    return run_batches(blind, episodes, _BATCH, lambda chunk, *_: controller(who, chunk))
