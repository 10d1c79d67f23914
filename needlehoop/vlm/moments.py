"""Moments on which reward programs are judged: from scripted episodes, and drawn at random."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice
from typing import Any

import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import Controller, controller, controllers, rollout
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.rewards import NONE
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task
from needlehoop.tasks.psm import JOINT_SIGNALS
from needlehoop.vlm.config import Gates

CHEAT = "cheat"
"""The controller that only looks as if it did the task; not every task has one."""


@dataclass(frozen=True)
class Trajectories:
    """Episodes of the scripted controllers."""

    moments: Signals
    """Every moment of every episode, ``(total,)``, the starts included."""
    last: dict[str, Signals]
    """Each episode's last moment, ``(episodes,)``, by controller. The cheat's has the expert's
    ``elapsed``, because it must not fail by being slow alone."""
    before: Signals
    """The start of every step of more random episodes, ``(steps,)``."""
    after: Signals
    """The end of the same steps, with ``elapsed`` as at their start, because time alone does not
    pay."""
    stopped: Mapping[str, tuple[Signals, Signals]]
    """See ``_stopped``."""


_collected: dict[str, Trajectories] = {}
"""The last trajectories, by all that they depend on: one process judges many programs by them."""


def collect(settings: Settings, gates: Gates) -> Trajectories:
    """Episodes of the expert, the cheat, if any, and a random policy, without cameras and reward.

    ``ValueError`` for settings that the scripts cannot drive, by key.
    """
    blind = _blind(replace(settings, seed=gates.seed), gates.episodes)
    key = repr((blind, gates))
    if key in _collected:
        return _collected[key]
    simulation = build(blind)
    flights = {
        name: _fly(simulation, controller(name, blind))
        for name in ("expert", CHEAT, "random")
        if name in controllers(blind)
    }
    moments = torch.cat([flight.signals[flight.until_goal()] for flight in flights.values()])
    last = {name: flight.last() for name, flight in flights.items()}
    if CHEAT in last:
        last[CHEAT].elapsed = last["expert"].elapsed.clone()
    batch = replace(blind, num_envs=gates.random_episodes)
    steps = _fly(build(batch), controller("random", batch), whole=True).signals
    before, after = steps[:-1].reshape(-1), steps[1:].reshape(-1)
    after.elapsed = before.elapsed.clone()
    stopped = _stopped(blind, gates.stop_episodes)
    _collected.clear()
    _collected[key] = Trajectories(moments, last, before, after, stopped)
    return _collected[key]


def _blind(settings: Settings, episodes: int) -> Settings:
    """So many episodes at once. Success does not end them: ranges would tell what success is."""
    episode = replace(settings.episode, end_on_success=False)
    return replace(settings, cams=(), num_envs=episodes, reward=NONE, episode=episode)


@dataclass(frozen=True)
class _Flight:
    """Episodes side by side, step by step: all is ``(steps, n)``."""

    signals: Any
    alive: Tensor
    at_goal: Tensor

    def until_goal(self) -> Tensor:
        """The moments up to each episode's goal or its end, that one included."""
        return self.alive & (self.at_goal.cumsum(0) - self.at_goal.long() == 0)

    def last(self) -> Any:
        """Each episode's last of these moments, ``(n,)``."""
        at = self.until_goal().sum(0) - 1
        return self.signals[at, torch.arange(len(at))]


def _fly(
    simulation: Simulation, act: Controller, whole: bool = False, most: int | None = None
) -> _Flight:
    """Fly one episode in each environment, up to its goal (``whole``: to its end), for at most
    ``most`` steps.
    """
    simulation.reseed(simulation.settings.seed)
    signals: list[Any] = []
    alive: list[Tensor] = []
    done = torch.zeros(simulation.num_envs, dtype=torch.bool)
    for step in islice(rollout(simulation, act), most):
        signals.append(step.moment.signals.clone())
        alive.append(step.alive)
        done |= ~step.alive | step.moment.facts[simulation.task.goal]
        if bool(done.all()) and not whole:
            break
    stacked: Any = torch.stack(signals)
    return _Flight(stacked, torch.stack(alive), getattr(stacked, simulation.task.goal))


def _stopped(blind: Settings, episodes: int) -> dict[str, tuple[Signals, Signals]]:
    """Last moments of the teacher stopped short, and of the same episodes finished.

    It flies up to a moment, then holds still, or lets go. The moments are those at which a fact
    that is not the goal first became true, and the moments half-way through each phase. It lets
    go at the end of the first phase and at the last fact before the goal. Episodes that reach the
    goal all the same are left out. ``elapsed`` is that of the finished ones.
    """
    s = replace(blind, num_envs=episodes)
    task, act, simulation = s.definition, controller(s.definition.teacher, s), build(s)
    flight = _fly(simulation, act)
    finished, pairs = flight.last(), {}
    opens, facts = task.robot.opens, [fact.name for fact in task.facts if fact.name != task.goal]
    loose = {task.phases[0].ends, facts[-1]} - {task.goal} if facts and opens else ()
    for moment, first in _firsts(flight, task, facts).items():
        for loosen in (False, True) if moment in loose else (False,):
            short = _short(act, first, opens if loosen else ())
            # 20 steps after it stopped all has come to rest.
            stop = _fly(simulation, short, most=int(first.max()) + 21)
            ended = (first >= 0) & (stop.alive & ~stop.at_goal).all(0)
            if bool(ended.any()):
                whole, last = finished[ended], stop.signals[-1][ended]
                last.elapsed = whole.elapsed.clone()
                pairs[f"{'letting go' if loosen else 'holding still'} at {moment}"] = last, whole
    return pairs


def _firsts(flight: _Flight, task: Task, facts: Sequence[str]) -> dict[str, Tensor]:
    """The steps ``(n,)`` at which each moment of ``_stopped`` first came, by its name; -1 where it
    did not come before the goal."""
    counts = flight.alive & ~flight.at_goal
    moments = {name: getattr(flight.signals, name) for name in facts}
    begun = torch.ones_like(counts)
    for phase in task.phases:
        a, b, over = (getattr(flight.signals, name) for name in (*phase.points, phase.ends))
        way = torch.linalg.vector_norm(a - b, dim=-1)
        whole = way.gather(0, begun.long().argmax(0, keepdim=True))
        moments[f"half of {phase.name}"] = (begun.cumsum(0) > 0) & (way <= whole / 2)
        ended = over & counts
        begun = begun & (over | (ended.cumsum(0) - ended.long() > 0))
    came = {name: (now & counts).long() for name, now in moments.items()}
    return {name: torch.where(now.any(0), now.argmax(0), -1) for name, now in came.items()}


def _short(act: Controller, first: Tensor, opens: Sequence[int]) -> Controller:
    """Acts up to the step ``first``, then holds still; ``opens``: the actions that let go."""
    numbers = count()

    def short(signals: Signals) -> Tensor:
        action = act(signals)
        still = (first >= 0) & (next(numbers) >= first)
        action[still] = 0.0
        for index in opens:
            action[still, index] = 1.0
        return action

    return short


def ranges(settings: Settings) -> dict[str, tuple[list[float], list[float]]]:
    """The least and the most of each signal, number by number, over 8 whole episodes of the task's
    teacher and 8 of a random policy."""
    s = _blind(settings, 8)
    simulation = build(s)
    moments = [
        _fly(simulation, controller(name, s), whole=True).signals
        for name in (s.definition.teacher, "random")
    ]
    ends = {}
    for name, signal in s.definition.signals.items():
        size = math.prod(signal.shape)
        values = torch.cat([getattr(moment, name).double().reshape(-1, size) for moment in moments])
        ends[name] = values.amin(0).tolist(), values.amax(0).tolist()
    return ends


def random_signals(task: Task, count: int, seed: int) -> Signals:
    """``count`` moments with signals drawn one by one. Their combination is often impossible.

    Points within ±0.3 m along each axis, unit quaternions and axes, angles within ±3.2 rad,
    insertion within 0 to 0.24 m, shares of 0 to 1, facts true or false. In every eighth moment all
    points coincide, to find programs that divide by a distance.
    """
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    fields = {}
    for name, signal in task.signals.items():
        share = uniform(count, *signal.shape)
        either_way = 2 * share - 1
        if signal.unit == "bool":
            fields[name] = share < 0.5
        elif signal.unit == "m":
            fields[name] = 0.3 * either_way
        elif signal.unit != "1":
            fields[name] = 3.2 * either_way
        elif signal.shape:
            fields[name] = either_way / torch.linalg.vector_norm(either_way, dim=-1, keepdim=True)
        else:
            fields[name] = share
    if task.signals.get("joints") == JOINT_SIGNALS["joints"]:
        # The PSM's; the insertion is a length.
        fields["joints"][:, 2] = 0.24 * uniform(count)
    points = [name for name, row in task.signals.items() if row.unit == "m" and row.shape == (3,)]
    for name in points:
        fields[name][::8] = fields[points[0]][::8]
    return task.signals_class(**fields, batch_size=[count])
