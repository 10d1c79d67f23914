"""Scripted demonstrators: the experts, and a perturbed one."""

from __future__ import annotations

from itertools import count

import torch
from torch import Tensor

from needlehoop.demonstrations.flights import BATCH, Pilot
from needlehoop.envs.controllers import controller
from needlehoop.envs.perturbation import Perturbation
from needlehoop.envs.rollout import Controller
from needlehoop.envs.settings import Settings
from needlehoop.scene.signals import Signals

SCRIPTS = ("smooth", "expert", "perturbed")
"""``perturbed``: the smooth expert, led astray by noise and coming back."""

_STRONGEST = 0.8
"""Of a perturbed episode's noise, in units of the action: the smooth expert still threads then."""


def scripted(name: str) -> Pilot:
    """A scripted demonstrator.

    Raises:
        ValueError: an unknown name.
    """
    if name not in SCRIPTS:
        raise ValueError(
            f"demonstrator: {name!r} is unknown; choose from {', '.join(SCRIPTS)},"
            " or give a run's folder"
        )
    if name == "perturbed":
        return _perturbed()
    return lambda settings, *_: controller(name, settings)


def _perturbed() -> Pilot:
    batches = count()

    def pilot(settings: Settings, *_: object) -> Controller:
        # A batch's noise is drawn for a full one: an episode is the same in a smaller.
        generator = torch.Generator().manual_seed(settings.seed + (next(batches) << 32))
        noise = Perturbation(BATCH, settings.episode.action_size, _STRONGEST, generator)
        expert = controller("smooth", settings)

        def act(signals: Signals) -> Tensor:
            return expert(signals) + noise()[: len(signals.jaw)]

        return act

    return pilot
