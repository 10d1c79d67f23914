"""Controllers by name, the episodes that they run, and their outcomes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from tensordict import TensorClass, TensorDict
from torch import Tensor

from needlehoop.config.strict import check_names
from needlehoop.envs.build import build
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation, StepResult
from needlehoop.rewards import potential, reference_reward
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Controller

NOISE_MEMORY = 0.7
"""Share of the noise that stays from step to step."""

MakeController = Callable[[Simulation], Controller]


def controllers(settings: Settings) -> tuple[str, ...]:
    """Names of the controllers of an environment's task."""
    return (*settings.definition.controllers, "random")


def controller(name: str, settings: Settings) -> Controller:
    """A controller for an environment's settings.

    Raises ``ValueError`` for an unknown name, or a script for another control mode.
    """
    check_names("controller", [name], controllers(settings))
    if name != "random":
        return settings.definition.controllers[name](settings.task, settings.episode)
    generator = torch.Generator().manual_seed(settings.seed)

    def act(signals: Signals) -> Tensor:
        """Uniform over the whole range."""
        shape = (*signals.batch_size, settings.episode.action_size)
        drawn = torch.rand(shape, generator=generator, dtype=torch.float64)
        return 2.0 * drawn.to(signals.elapsed.device) - 1.0

    return act


def by_name(name: str) -> MakeController:
    """Makes the controller of a name for any simulation; errors as in ``controller``."""
    return lambda simulation: controller(name, simulation.settings)


class Perturbation:
    """Correlated noise on actions: an expert under it shows how to correct errors.

    Each episode draws its strength, uniform up to ``strongest``, in units of the action. Numbers
    come from a ``generator`` of the CPU, so that they are the same for environments on a GPU.
    """

    def __init__(
        self,
        num_envs: int,
        size: int,
        strongest: float,
        generator: torch.Generator,
        device: torch.device | None = None,
    ):
        self._strongest, self._generator = strongest, generator
        self.drift = torch.zeros(num_envs, size, dtype=torch.float64, device=device)
        self.strength = self._strongest * self._draw(num_envs, 1)

    def begin(self, mask: Tensor) -> None:
        """Draw a new strength, and forget the noise, where ``mask`` ``(n,)`` is true."""
        fresh = self._strongest * self._draw(*self.strength.shape)
        self.strength = torch.where(mask.unsqueeze(-1), fresh, self.strength)
        self.drift = torch.where(mask.unsqueeze(-1), 0.0, self.drift)

    def __call__(self, mask: Tensor | None = None) -> Tensor:
        """The next noise ``(n, size)``, float64, where ``mask`` ``(n,)`` is true (everywhere)."""
        drift = NOISE_MEMORY * self.drift + 2.0 * self._draw(*self.drift.shape) - 1.0
        self.drift = drift if mask is None else torch.where(mask.unsqueeze(-1), drift, self.drift)
        return self.strength * self.drift

    def _draw(self, *shape: int) -> Tensor:
        drawn = torch.rand(shape, generator=self._generator, dtype=torch.float64)
        return drawn.to(self.drift.device)


@dataclass(frozen=True)
class Step:
    """One step of ``n`` environments."""

    moment: StepResult
    action: Tensor | None
    """``(n, action_size)``, which led to ``moment``; ``None`` at the start."""
    alive: Tensor
    """``(n,)`` bool. False once the environment's episode is over; its last moment still counts."""

    @property
    def goes_on(self) -> Tensor:
        """Episodes ``(n,)`` bool that have a step after this one."""
        return self.alive & ~(self.moment.terminated | self.moment.truncated)


def rollout(simulation: Simulation, controller: Controller) -> Iterator[Step]:
    """Reset, and run one episode in every environment until all are over."""
    moment, action = simulation.reset(), None
    alive = torch.ones(simulation.num_envs, dtype=torch.bool, device=simulation.device)
    while True:
        step = Step(moment, action, alive)
        yield step
        alive = step.goes_on
        if not bool(alive.any()):
            return
        action = controller(moment.signals)
        moment = simulation.step(action)


def batches(settings: Settings, episodes: int, size: int) -> Iterator[Simulation]:
    """The first ``episodes`` environments of the settings' seed, ``size`` at a time.

    Episode ``i`` does not depend on how many there are. ``settings.num_envs`` is ignored. Raises
    ``ValueError`` for fewer than one episode.
    """
    if episodes < 1:
        raise ValueError(f"episodes: {episodes} must be at least 1")
    for first in range(0, episodes, size):
        batch = replace(settings, num_envs=min(size, episodes - first))
        yield build(batch, first_env=first)


class Outcome(TensorClass):
    """How episodes ended, ``(n,)`` each, at each episode's own last step."""

    facts: TensorDict
    """What was true, by the names of ``Task.columns``."""
    potential: Tensor
    human: Tensor
    """The potential of the human reward with its default values."""
    steps: Tensor

    @property
    def success(self) -> Tensor:
        return self.facts["success"]

    def summary(self) -> dict[str, float | int]:
        """Rates over episodes, mean final potential (the return) and mean length."""
        return {
            "episodes": len(self.steps),
            **{name: float(fact.double().mean()) for name, fact in self.facts.items()},
            "return": float(self.potential.mean()),
            "return_min": float(self.potential.min()),
            "return_max": float(self.potential.max()),
            "return_human": float(self.human.mean()),
            "steps": float(self.steps.double().mean()),
        }


def run_batches(settings: Settings, episodes: int, size: int, make: MakeController) -> Outcome:
    """The outcome of one episode in each of ``episodes`` environments; see ``batches``."""
    return Outcome.cat([outcome_of(one, make(one)) for one in batches(settings, episodes, size)])


def outcome_of(simulation: Simulation, controller: Controller) -> Outcome:
    """The outcome of one episode in each environment, on the CPU."""
    columns, human = simulation.task.columns, reference_reward(simulation.task)
    size = [simulation.num_envs]

    def now(moment: StepResult) -> Outcome:
        return Outcome(
            facts=TensorDict({name: moment.facts[fact] for name, fact in columns.items()}, size),
            potential=moment.potential,
            human=potential(human(moment.signals)),
            steps=moment.steps,
            batch_size=size,
        )

    steps = rollout(simulation, controller)
    last = now(next(steps).moment)
    for step in steps:
        last = now(step.moment).where(step.alive, last)
    return last.cpu()


def run_trials(settings: Settings, name: str, episodes: int) -> Outcome:
    """The outcome of a named controller; ``num_envs`` and cameras of the settings are ignored."""
    blind = replace(settings, cams=())
    return run_batches(blind, episodes, size=200, make=by_name(name))
