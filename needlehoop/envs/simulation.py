"""The task on an engine: what every environment interface steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from needlehoop.engines.contract import Engine
from needlehoop.rewards import Reward, potential
from needlehoop.scene.layout import Layout
from needlehoop.scene.signals import Readings, Signals
from needlehoop.task.control import act
from needlehoop.task.episode import Episode
from needlehoop.task.facts import is_successful, is_terminated, is_truncated, observe
from needlehoop.task.memory import State, begin
from needlehoop.task.start import draws, start


@dataclass(frozen=True)
class Moment:
    """What is known after a reset or a step; leading dimension ``n``.

    ``terms`` are the reward's, ``potential`` their sum, ``reward`` what this step pays
    (the potential's rise; the first step pays it whole). ``success``: the task is done now, as
    ``episode.success`` has it. ``has_grasped`` and
    ``has_touched``: at some time in this episode. ``steps``: taken in it. ``diverged``: the
    physics broke down. Then the episode is truncated, and ``signals`` are read from the last
    moment before.
    """

    signals: Signals
    terms: dict[str, Tensor]
    potential: Tensor
    reward: Tensor
    success: Tensor
    terminated: Tensor
    truncated: Tensor
    has_grasped: Tensor
    has_touched: Tensor
    diverged: Tensor
    steps: Tensor

    @property
    def cheat(self) -> Tensor:
        """The tip has touched the goal in this episode, and the needle is not through."""
        return self.has_touched & ~self.signals.threaded

    def facts(self) -> dict[str, Tensor]:
        """Every fact ``(n,)`` bool by name: the moment's own, then the episode's."""
        s = self.signals
        return {
            "grasped": s.grasped,
            "lifted": s.lifted,
            "touched": s.touched,
            "threaded": s.threaded,
            "success": self.success,
            "cheat": self.cheat,
            "has_grasped": self.has_grasped,
            "has_touched": self.has_touched,
            "diverged": self.diverged,
        }


class Simulation:
    """Drives an engine through episodes of the task.

    ``act``, then ``engine.step`` with the returned control, then ``observe``: three calls,
    because dm_control steps the physics itself. ``step`` does all three.

    Args:
        engine: physics of ``n`` scenes.
        layout: sizes and ranges.
        episode: control and termination.
        reward: terms of the potential.
        seed: decides every episode of every environment.
        first_env: index of the engine's first environment among all that share the seed.
    """

    def __init__(
        self,
        engine: Engine,
        layout: Layout,
        episode: Episode,
        reward: Reward,
        seed: int,
        first_env: int = 0,
    ):
        self.engine, self.layout, self.episode, self.reward = engine, layout, episode, reward
        self._readings = Readings(engine.model)
        self._before = engine.sensordata()
        self._first_env = first_env
        self.reseed(seed)

    @property
    def num_envs(self) -> int:
        """Environments."""
        return self.engine.num_envs

    def reseed(self, seed: int) -> None:
        """Start over with the first episodes of a seed; takes effect at the next reset."""
        self._seed = seed
        self._episodes = np.zeros(self.num_envs, dtype=np.int64)
        self._potential = torch.zeros(self.num_envs, dtype=torch.float64)
        self.state: State | None = None

    def reset(self, mask: Tensor | None = None, stagger: bool = False) -> Moment:
        """``begin``, then ``look``."""
        self.begin(mask, stagger)
        return self.look()

    def begin(self, mask: Tensor | None = None, stagger: bool = False) -> None:
        """Begin the next episode where ``mask`` ``(n,)`` is true (everywhere by default).

        With ``stagger`` a seed's first episodes begin with a share of their steps used up,
        from none in the first environment to nearly all in the last.
        """
        if self.state is None or mask is None:
            mask = torch.ones(self.num_envs, dtype=torch.bool)
        ids = mask.nonzero().flatten()
        if len(ids):
            rows = [
                draws(self._seed, self._first_env + env, int(self._episodes[env]))
                for env in ids.tolist()
            ]
            starts = start(self.layout, torch.from_numpy(np.stack(rows)))
            fresh = begin(self.episode, starts)
            if self.state is None:
                if stagger:
                    spread = torch.arange(self.num_envs) * self.episode.max_steps
                    fresh.steps = spread // self.num_envs
                self.state = fresh
            else:
                self.state = self.state.clone()
                self.state[ids] = fresh
            self.engine.reset(ids, starts)
            self._potential[ids] = 0.0
            self._episodes[ids.numpy()] += 1

    def act(self, action: Tensor) -> Tensor:
        """Take an action ``(n, action_size)``; returns the servo commands ``(n, 7)``."""
        self.state, control = act(self.layout, self.episode, self._begun(), action)
        self._before = self.engine.sensordata()
        return control

    def observe(self) -> Moment:
        """Facts, reward and termination after the physics has moved."""
        return self._moment(pays=True)

    def step(self, action: Tensor) -> Moment:
        """One control step of every environment."""
        self.engine.step(self.act(action))
        return self.observe()

    def look(self) -> Moment:
        """The present moment once more: nothing moves, nothing is paid."""
        return self._moment(pays=False)

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides the future, as tensors and numbers."""
        return {
            "seed": self._seed,
            "episodes": torch.tensor(self._episodes),
            "potential": self._potential.clone(),
            "task": {name: value.clone() for name, value in self._begun().items()},
            "engine": self.engine.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot``; the same steps then give the same bits."""
        self._seed = snapshot["seed"]
        self._episodes = snapshot["episodes"].numpy().copy()
        self._potential = snapshot["potential"].clone()
        self.state = State(
            **{name: value.clone() for name, value in snapshot["task"].items()},
            batch_size=[self.num_envs],
        )
        self.engine.restore(snapshot["engine"])

    def _moment(self, pays: bool) -> Moment:
        data, diverged = self.engine.sensordata(), self.engine.diverged()
        if bool(diverged.any()):
            data[diverged] = self._before[diverged]
        readings = self._readings(data)
        self.state, signals, weld = observe(self.layout, self.episode, self._begun(), readings)
        self.engine.weld(weld)
        terms = self.reward(signals)
        total = potential(terms)
        reward = total - self._potential
        if pays:
            self._potential = total
        terminated = is_terminated(self.episode, signals)
        truncated = is_truncated(self.episode, self.state, signals) | (diverged & ~terminated)
        return Moment(
            signals=signals,
            terms=terms,
            potential=total,
            reward=reward,
            success=is_successful(self.episode, signals),
            terminated=terminated,
            truncated=truncated,
            has_grasped=self.state.has_grasped,
            has_touched=self.state.has_touched,
            diverged=diverged,
            steps=self.state.steps,
        )

    def _begun(self) -> State:
        if self.state is None:
            raise RuntimeError("reset before the first step")
        return self.state
