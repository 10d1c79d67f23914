"""Controllers by name, noise on their actions, and trials of them."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from needlehoop.config.strict import check_names
from needlehoop.envs.rollout import Controller, MakeController, Outcome, run_batches
from needlehoop.envs.settings import Settings
from needlehoop.scene.signals import Signals

NOISE_MEMORY = 0.7
"""Share of the noise that stays from step to step. It makes the noise lead somewhere."""


def controllers(settings: Settings) -> tuple[str, ...]:
    """Names of the controllers of an environment's task."""
    return (*settings.definition.controllers, "random")


def controller(name: str, settings: Settings) -> Controller:
    """A controller for an environment's settings.

    Raises:
        ValueError: an unknown name, or a script for another control mode.
    """
    if name == "random":
        return random_controller(settings.episode.action_size, settings.seed)
    check_names("controller", [name], controllers(settings))
    return settings.definition.controllers[name](settings.task, settings.episode)


def by_name(name: str) -> MakeController:
    """Makes the controller of a name for any simulation; errors as in ``controller``."""
    return lambda simulation: controller(name, simulation.settings)


def random_controller(action_size: int, seed: int) -> Controller:
    """Uniform actions over the whole range."""
    generator = torch.Generator().manual_seed(seed)

    def act(signals: Signals) -> Tensor:
        shape = (*signals.batch_size, action_size)
        return 2.0 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1.0

    return act


class Perturbation:
    """Correlated noise on actions; an expert under it shows how to correct errors.

    Each episode draws its strength, uniform up to ``strongest``, in units of the action.
    """

    def __init__(self, num_envs: int, size: int, strongest: float, generator: torch.Generator):
        self._strongest, self._generator = strongest, generator
        self._drift = torch.zeros(num_envs, size, dtype=torch.float64)
        self._strength = torch.zeros(num_envs, 1, dtype=torch.float64)
        self.begin(torch.ones(num_envs, dtype=torch.bool))

    def begin(self, mask: Tensor) -> None:
        """Draw a new strength, and forget the noise, where ``mask`` ``(n,)`` is true."""
        fresh = self._strongest * self._draw(*self._strength.shape)
        self._strength = torch.where(mask.unsqueeze(-1), fresh, self._strength)
        self._drift = torch.where(mask.unsqueeze(-1), 0.0, self._drift)

    def __call__(self) -> Tensor:
        """This step's noise ``(n, size)``, float64."""
        self._drift = NOISE_MEMORY * self._drift + 2.0 * self._draw(*self._drift.shape) - 1.0
        return self._strength * self._drift

    def snapshot(self) -> dict[str, Tensor]:
        """What decides the next noise, but for the generator."""
        return {"drift": self._drift, "strength": self._strength}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a ``snapshot``."""
        self._drift, self._strength = snapshot["drift"], snapshot["strength"]

    def _draw(self, *shape: int) -> Tensor:
        return torch.rand(shape, generator=self._generator, dtype=torch.float64)


def run_trials(settings: Settings, who: str, episodes: int) -> Outcome:
    """What comes of a controller, in one episode of each of ``episodes`` environments.

    ``num_envs`` and cameras of the settings are ignored.

    Raises:
        ValueError: fewer than one episode, or an unknown controller.
    """
    blind = replace(settings, cams=())
    return run_batches(blind, episodes, size=200, make=by_name(who))
