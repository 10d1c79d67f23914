"""Moments on which reward programs are judged: from scripted episodes, and drawn at random."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, controllers
from needlehoop.envs.rollout import Controller, Step, rollout
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.rewards import NONE
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task
from needlehoop.tasks.psm import JOINT_SIGNALS
from needlehoop.vlm.config import Gates

_REACH = 0.3
"""Random points lie within this distance of the origin along each axis, m."""
_TURN = 3.2
"""Random angles lie within this of 0, rad."""

CHEAT = "cheat"
"""The controller that only looks as if it did the task; not every task has one."""

_JUDGED_BY = ("expert", CHEAT, "random")
"""Controllers on whose episodes programs are judged, where the task has them."""


@dataclass(frozen=True)
class Trajectories:
    """Episodes of the scripted controllers.

    Args:
        moments: every moment of every episode, ``(total,)``, the starts included.
        last: each episode's last moment, ``(episodes,)``, by controller.
        before: the start of every step of more random episodes, ``(steps,)``.
        after: the end of the same steps, with ``elapsed`` as at their start: a change that time
            alone brings does not count as paid.
        stopped: the last moments of episodes in which the teacher stopped short, and those of the
            same episodes finished, by what was done; see ``_stopped``.
    """

    moments: Signals
    last: dict[str, Signals]
    before: Signals
    after: Signals
    stopped: Mapping[str, tuple[Signals, Signals]]


def collect(settings: Settings, gates: Gates) -> Trajectories:
    """Episodes of the expert, a random policy and the cheat, if any, and more of the random policy.

    One episode in each of ``gates.episodes`` environments of ``gates.seed``, without cameras.

    Raises:
        ValueError: settings that the scripts cannot drive, by key.
    """
    blind = _blind(replace(settings, seed=gates.seed), gates.episodes)
    simulation, _ = build(blind)
    moments: list[Signals] = []
    last = {}
    valid = controllers(blind)
    for who in (who for who in _JUDGED_BY if who in valid):
        simulation.reseed(gates.seed)
        steps = rollout(simulation, controller(who, blind))
        lived, last[who] = _episodes(steps, blind.definition.goal)
        moments += lived
    return Trajectories(_join(moments), last, *_random_steps(blind, gates), _stopped(blind, gates))


def _blind(settings: Settings, episodes: int) -> Settings:
    """So many episodes at once, without cameras and with a reward that nobody reads.

    Success does not end them: programs are judged up to the goal, whatever else counts as success,
    and ranges would tell what success is.
    """
    episode = replace(settings.episode, end_on_success=False)
    return replace(settings, cams=(), num_envs=episodes, reward=NONE, episode=episode)


_HELD = 20
"""Steps that the teacher waits where it stopped short; by then all has come to rest."""


def _stopped(settings: Settings, gates: Gates) -> dict[str, tuple[Signals, Signals]]:
    """Last moments of the teacher stopped short, and of the same episodes finished.

    It flies as always up to a moment, then holds still, or lets go. The moments are those at which
    a fact that is not the goal first became true, and those at which half the way of a phase is
    gone. It lets go where the first phase ended, and at the last fact before the goal. Episodes
    that reach the goal all the same are left out. ``elapsed`` is that of the finished ones.
    """
    s = replace(settings, num_envs=gates.stop_episodes)
    task, act = s.definition, controller(s.definition.teacher, s)
    simulation, _ = build(s)
    simulation.reseed(gates.seed)
    firsts: dict[str, Tensor] = {}
    _, finished = _episodes(_watched(rollout(simulation, act), task, firsts), task.goal)
    found = {}
    opens, facts = task.robot.opens, [fact.name for fact in task.facts if fact.name in firsts]
    loose = {task.phases[0].ends, facts[-1]} - {task.goal} if facts and opens is not None else ()
    for moment, first in firsts.items():
        for loosen in (False, True) if moment in loose else (False,):
            simulation.reseed(gates.seed)
            ended, last = _stop(simulation, act, first, opens if loosen else None, task.goal)
            if bool(ended.any()):
                whole: Any = finished[ended].clone()
                short: Any = last[ended].clone()
                short.elapsed = whole.elapsed.clone()
                found[f"{'letting go' if loosen else 'holding still'} at {moment}"] = short, whole
    return found


def _watched(steps: Iterator[Step], task: Task, firsts: dict[str, Tensor]) -> Iterator[Step]:
    """The steps; notes when each moment at which a task can be stopped short first came.

    ``firsts`` has the steps ``(n,)`` by the moment's name; -1 where it did not come before the
    goal.
    """
    begun_at: dict[str, Tensor] = {}
    for number, step in enumerate(steps):
        facts = step.moment.facts
        begun = torch.ones_like(step.alive)
        moments = {f.name: facts[f.name] for f in task.facts if f.name != task.goal}
        for phase in task.phases:
            a, b = (getattr(step.signals, point) for point in phase.points)
            way = torch.linalg.vector_norm(a - b, dim=-1)
            whole = begun_at.setdefault(phase.name, torch.full_like(way, torch.nan))
            whole[:] = torch.where(begun & whole.isnan(), way, whole)
            moments[f"half of {phase.name}"] = way <= whole / 2
            since = firsts[phase.ends] >= 0 if phase.ends in firsts else False
            begun = begun & (facts[phase.ends] | since)
        for name, now in moments.items():
            first = firsts.setdefault(name, torch.full_like(step.moment.steps, -1))
            first[now & step.alive & ~facts[task.goal] & (first < 0)] = number
        yield step


def _stop(
    simulation: Simulation, act: Controller, first: Tensor, opens: int | None, goal: str
) -> tuple[Tensor, Signals]:
    """Which episodes stopped at their step ``first`` and never reached the goal; last moments."""
    number, stopped = 0, first >= 0

    def short(signals: Signals) -> Tensor:
        nonlocal number
        action = act(signals)
        still = stopped & (number >= first)
        action[still] = 0.0
        if opens is not None:
            action[still, opens] = 1.0
        number += 1
        return action

    ended, last = stopped.clone(), None
    for step in rollout(simulation, short):
        ended &= step.alive & ~step.moment.facts[goal]
        last = step.signals.clone()
        if number >= int(first.max()) + _HELD:
            break
    return ended, last


_RANGED = 8
"""Episodes of each controller over which the ranges of signals are told."""


def ranges(settings: Settings) -> dict[str, tuple[list[float], list[float]]]:
    """The least and the most of each signal, number by number.

    Over whole episodes of the task's teacher and of a random policy.
    """
    s = _blind(settings, _RANGED)
    simulation, _ = build(s)
    moments: list[Signals] = []
    for who in (s.definition.teacher, "random"):
        simulation.reseed(s.seed)
        moments += _signals(simulation, who, s)
    joined = _join(moments)
    found = {}
    for name in s.definition.signals:
        values = getattr(joined, name).double().reshape(len(joined), -1)
        found[name] = values.amin(0).tolist(), values.amax(0).tolist()
    return found


def _random_steps(settings: Settings, gates: Gates) -> tuple[Signals, Signals]:
    """The moments before and after each step of episodes of uniformly random actions."""
    own = replace(settings, num_envs=gates.random_episodes)
    simulation, _ = build(own)
    moments = _signals(simulation, "random", own)
    before, after = _join(moments[:-1]), _join(moments[1:])
    after.elapsed = before.elapsed.clone()
    return before, after


def _signals(simulation: Simulation, who: str, settings: Settings) -> list[Signals]:
    """The moments of whole episodes of a controller, step by step."""
    return [step.signals.clone() for step in rollout(simulation, controller(who, settings))]


def _join(moments: list[Signals]) -> Signals:
    joined: Any = torch.cat(moments)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return joined


def _episodes(steps: Iterator[Step], goal: str) -> tuple[list[Signals], Signals]:
    """The moments of episodes up to their goal, step by step, and each episode's last."""
    lived: list[Signals] = []
    last: Any = None
    goes_on: Any = True
    for step in steps:
        goes_on = goes_on & step.alive
        now: Any = step.signals[goes_on].clone()
        lived.append(now)
        last = now.clone() if last is None else last
        last[goes_on] = now
        goes_on = goes_on & ~step.moment.facts[goal]
        if not bool(goes_on.any()):
            break
    return lived, last


def random_signals(task: Task, count: int, seed: int) -> Signals:
    """``count`` moments with signals drawn one by one. Their combination is often impossible.

    Points within ±0.3 m, unit quaternions and axes, angles within ±3.2 rad, insertion within
    0 to 0.24 m, shares of 0 to 1, facts true or false. In every eighth moment all points
    coincide, to find programs that divide by a distance.
    """
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    fields = {}
    for name, signal in task.signals.items():
        shape = (count, *signal.shape)
        if signal.unit == "bool":
            fields[name] = uniform(*shape) < 0.5
        elif signal.unit == "m":
            fields[name] = _REACH * (2 * uniform(*shape) - 1)
        elif signal.shape:
            fields[name] = 2 * uniform(*shape) - 1
            if signal.unit == "1":
                fields[name] /= torch.linalg.vector_norm(fields[name], dim=-1, keepdim=True)
            else:
                fields[name] *= _TURN
        else:
            fields[name] = (
                uniform(*shape) if signal.unit == "1" else _TURN * (2 * uniform(count) - 1)
            )
    if task.signals.get("joints") == JOINT_SIGNALS["joints"]:
        # The PSM's; the insertion is a length.
        fields["joints"][:, 2] = 0.24 * uniform(count)
    points = [name for name, row in task.signals.items() if row.unit == "m" and row.shape == (3,)]
    for name in points:
        fields[name][::8] = fields[points[0]][::8]
    return task.signals_class(**fields, batch_size=[count])
