"""Whole episodes under a controller, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.images import Imager
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.rewards import potential, yardstick
from needlehoop.scene.signals import Signals

Controller = Callable[[Signals], Tensor]


@dataclass(frozen=True)
class Outcome:
    """How episodes ended, ``(n,)`` each, at each episode's own last step.

    ``touched`` and ``grasped`` at any time of the episode.
    """

    success: Tensor
    threaded: Tensor
    cheat: Tensor
    touched: Tensor
    grasped: Tensor
    lifted: Tensor
    potential: Tensor
    human: Tensor
    """The potential of the human reward with its default values."""
    steps: Tensor

    def summary(self) -> dict[str, float | int]:
        """Rates over episodes, mean final potential (the return) and mean length."""
        n = len(self.steps)
        rates = {
            name: float(getattr(self, name).double().mean())
            for name in ("success", "threaded", "cheat", "touched", "grasped", "lifted")
        }
        return {
            "episodes": n,
            **rates,
            "return": float(self.potential.mean()),
            "return_min": float(self.potential.min()),
            "return_max": float(self.potential.max()),
            "return_human": float(self.human.mean()),
            "steps": float(self.steps.double().mean()),
        }


def run_batches(
    settings: Settings,
    episodes: int,
    batch: int,
    pilot: Callable[[Settings, Simulation, Imager], Controller],
) -> Outcome:
    """One first episode in each of ``episodes`` environments of the settings' seed.

    Args:
        settings: environment; ``num_envs`` is ignored.
        episodes: how many; episode ``i`` is the same however many there are.
        batch: environments at once.
        pilot: makes the controller of a batch from its settings, simulation and imager.

    Raises:
        ValueError: fewer than one episode.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes} must be at least 1")
    outcomes = []
    for first in range(0, episodes, batch):
        chunk = replace(settings, num_envs=min(batch, episodes - first))
        simulation, imager = build(chunk, first_env=first)
        outcomes.append(run_episodes(simulation, pilot(chunk, simulation, imager)))
    return _join(outcomes)


def _join(outcomes: Sequence[Outcome]) -> Outcome:
    """Outcomes of several batches as one."""
    return Outcome(
        **{
            field.name: torch.cat([getattr(outcome, field.name) for outcome in outcomes])
            for field in fields(Outcome)
        }
    )


def random_controller(action_size: int, seed: int) -> Controller:
    """Uniform actions over the whole range."""
    generator = torch.Generator().manual_seed(seed)

    def act(signals: Signals) -> Tensor:
        shape = (len(signals.jaw), action_size)
        return 2.0 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1.0

    return act


def run_episodes(simulation: Simulation, controller: Controller) -> Outcome:
    """One episode in every environment.

    Args:
        simulation: reset by this call.
        controller: signals to actions.
    """
    moment = simulation.reset()
    human = yardstick()
    n = simulation.num_envs
    open_ = torch.ones(n, dtype=torch.bool)
    last: dict[str, Tensor] = {}
    for step in range(1, simulation.episode.max_steps + 1):
        moment = simulation.step(controller(moment.signals))
        now = {
            "success": moment.success,
            "threaded": moment.signals.threaded,
            "cheat": moment.cheat,
            "touched": moment.has_touched,
            "grasped": moment.has_grasped,
            "lifted": moment.signals.lifted,
            "potential": moment.potential,
            "human": potential(human(moment.signals)),
            "steps": torch.full((n,), step),
        }
        last = {k: torch.where(open_, v, last[k]) if last else v.clone() for k, v in now.items()}
        open_ &= ~(moment.terminated | moment.truncated)
        if not bool(open_.any()):
            break
    return Outcome(**last)
