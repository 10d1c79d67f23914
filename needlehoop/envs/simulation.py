"""The task on an engine, which every environment interface steps, and what an agent sees of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from needlehoop.disturbances.disturbance import Disturbance
from needlehoop.envs.images import Imager
from needlehoop.envs.settings import Observations, Settings, sources
from needlehoop.rewards import Reward, potential
from needlehoop.scene.signals import Readings, Signals, columns
from needlehoop.tasks.contract import DIVERGED, Task
from needlehoop.tasks.start import Chance, draws
from needlehoop.tasks.stepping import act, begin, ends, observe

if TYPE_CHECKING:
    from needlehoop.engines.engine import Engine


@dataclass(frozen=True)
class StepResult:
    """What is known after a reset or a step; leading dimension ``n``."""

    signals: Signals
    """Where the physics ``diverged``, those of the last moment before."""
    terms: dict[str, Tensor]
    """Of the reward, by name."""
    potential: Tensor
    """The sum of the terms."""
    reward: Tensor
    """The rise of the potential in this step; the first step pays all of it."""
    facts: dict[str, Tensor]
    """Every fact ``(n,)`` bool by name, in the order of ``Task.all_facts``."""
    terminated: Tensor
    truncated: Tensor
    steps: Tensor
    """Taken in the episode."""


class Simulation:
    """Drives an engine through episodes of the task.

    ``act``, then ``engine.step`` with the returned control, then ``observe``: three calls,
    because dm_control steps the physics itself. ``step`` does all three.

    ``first_env``: index of the engine's first environment among all that share the seed.
    """

    def __init__(
        self,
        settings: Settings,
        engine: Engine,
        imager: Imager,
        reward: Reward,
        first_env: int = 0,
        disturbance: Disturbance | None = None,
    ):
        self.settings, self.engine, self.imager, self.reward = settings, engine, imager, reward
        self.task = settings.definition
        self.layout, self.episode = settings.task, settings.episode
        self._readings = Readings(engine.model, self.task.signals)
        self.device = engine.device
        """Where all tensors are."""
        self._before = engine.sensordata()
        self.envs = first_env + np.arange(engine.num_envs)
        self.disturbance = disturbance
        self.reseed(settings.seed)

    @property
    def num_envs(self) -> int:
        return self.engine.num_envs

    def reseed(self, seed: int) -> None:
        """Start over with the first episodes of a seed; takes effect at the next reset."""
        self._seed = seed
        self._episodes = np.zeros(self.num_envs, dtype=np.int64)
        self._potential = torch.zeros(self.num_envs, dtype=torch.float64, device=self.device)
        self.state: Any = None
        """What the task remembers (``Memory``); ``None`` before the first reset."""

    def reset(self, mask: Tensor | None = None, stagger: bool = False) -> StepResult:
        """``begin``, then ``look``."""
        self.begin(mask, stagger)
        return self.look()

    def begin(self, mask: Tensor | None = None, stagger: bool = False) -> None:
        """Begin the next episode where ``mask`` ``(n,)`` is true (everywhere by default).

        With ``stagger`` a seed's first episodes begin with a share of their steps used up,
        from none in the first environment to nearly all in the last.
        """
        if self.state is None or mask is None:
            mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        ids = mask.nonzero().flatten()
        if not len(ids):
            return
        rows = ids.cpu().numpy()
        envs, episodes = self.envs[rows], self._episodes[rows]
        # On the CPU, so that an episode begins alike on any device.
        numbers = [
            draws(self._seed, env, episode)
            for env, episode in zip(envs.tolist(), episodes.tolist(), strict=True)
        ]
        starts = self.task.start(self.layout, Chance(torch.from_numpy(np.stack(numbers))))
        fresh = begin(self.task, self.episode, starts).to(self.device)
        if self.state is not None:
            changed = self.state.clone()
            changed[ids] = fresh
            fresh = changed
        elif stagger:
            spread = torch.arange(self.num_envs, device=self.device) * self.episode.max_steps
            fresh["steps"] = spread // self.num_envs
        self.state = fresh
        if self.disturbance is not None:
            control = starts.control.to(self.device)
            self.disturbance.begin(ids, self._seed, envs, episodes, control)
            self._vary(ids)
        self.engine.reset(ids, starts)
        self._potential[ids] = 0.0
        self._episodes[rows] += 1

    def act(self, action: Tensor) -> Tensor:
        """Take an action ``(n, action_size)``; returns the servo commands ``(n, nu)``."""
        setup = (self.task, self.layout, self.episode)
        self.state, control = act(*setup, self.state, action)
        self._before = self.engine.sensordata()
        disturbance, displaced = self.disturbance, self.task.robot.displaced
        if disturbance is None:
            return control
        if displaced is not None and disturbance.offset is not None:
            control = displaced(*setup[1:], self.state, disturbance.offset)
        return disturbance.command(control)

    def observe(self) -> StepResult:
        """Facts, reward and ends after the physics has moved."""
        return self.look(pays=True)

    def step(self, action: Tensor) -> StepResult:
        """One control step of every environment."""
        self.engine.step(self.act(action))
        return self.observe()

    def images(self, ids: Tensor | None = None) -> dict[str, Tensor]:
        """Images ``(k, c, h, w)`` uint8 by camera of environments ``ids`` (all by default)."""
        disturbance, imager = self.disturbance, self.imager
        if disturbance is None:
            return imager(self.engine.render(ids))
        frames = self.engine.render(ids, disturbance.optics)
        return disturbance.deliver(imager(frames, disturbance.spoiler(ids)), imager.views, ids)

    def deal(self, ids: Tensor, envs: Tensor, amounts: Mapping[str, Tensor]) -> None:
        """Let environments ``ids`` ``(k,)`` be ``envs`` ``(k,)`` of the seed from the next reset.

        They begin with their first episodes. ``amounts``: of disturbances ``(k,)``, by axis.
        """
        rows = ids.cpu().numpy()
        self.envs[rows], self._episodes[rows] = envs.cpu().numpy(), 0
        if self.disturbance is not None:
            self.disturbance.deal(ids, amounts)

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides the future, as tensors and numbers."""
        extra = {} if self.disturbance is None else {"disturbance": self.disturbance.snapshot()}
        return {
            **extra,
            "seed": torch.tensor(self._seed),
            "episodes": torch.tensor(self._episodes),
            "potential": self._potential.clone(),
            "task": {name: value.clone() for name, value in self.state.items()},
            "engine": self.engine.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot``; the same steps then give the same bits."""
        self._seed = int(snapshot["seed"])
        self._episodes = snapshot["episodes"].numpy().copy()
        self._potential = snapshot["potential"].to(self.device, copy=True)
        kept = snapshot["task"].items()
        values = {name: value.to(self.device, copy=True) for name, value in kept}
        self.state = TensorDict(values, [self.num_envs])
        if self.disturbance is not None:
            self.disturbance.restore(snapshot["disturbance"])
            self._vary(torch.arange(self.num_envs, device=self.device))
        self.engine.restore(snapshot["engine"])

    def look(self, pays: bool = False) -> StepResult:
        """The present moment once more; nothing moves.

        ``pays``: whether the potential reached so far counts as paid from now on.
        """
        data, diverged = self.engine.sensordata(), self.engine.diverged()
        data = torch.where(diverged.unsqueeze(-1), self._before, data)
        setup = (self.task, self.layout, self.episode)
        self.state, signals, facts, welds = observe(*setup, self.state, self._readings(data))
        facts[DIVERGED] = diverged
        self.engine.weld(welds)
        terms = self.reward(signals)
        total = potential(terms)
        reward = total - self._potential
        if pays:
            self._potential = total
        terminated, truncated = ends(self.episode, self.state, facts)
        return StepResult(
            signals=signals,
            terms=terms,
            potential=total,
            reward=reward,
            facts=facts,
            terminated=terminated,
            truncated=truncated,
            steps=self.state["steps"],
        )

    def _vary(self, ids: Tensor) -> None:
        """Give environments the physics of their episodes."""
        factors = self.disturbance and self.disturbance.physics(ids)
        if factors is not None:
            self.engine.vary(ids, *factors)


def read(task: Task, obs: Observations, signals: Signals) -> dict[str, Tensor]:
    """The observed vectors, float32 ``(n, length)``, by the names of ``vectors``."""
    return {name: columns(names, signals) for name, names in sources(task, obs).items()}


class Observer:
    """Looks at a simulation the way an agent does, as its settings say."""

    def __init__(self, simulation: Simulation):
        self._simulation, self._obs = simulation, simulation.settings.obs
        self.pixels: dict[str, Tensor] = {}
        """The frames in memory, by camera; to be emptied where every episode is about to begin."""

    def __call__(
        self,
        signals: Signals,
        ids: Tensor | None = None,
        images: dict[str, Tensor] | None = None,
    ) -> dict[str, object]:
        """The observation of all ``n`` environments, as nested tensors by name.

        ``pixels``: ``(n, frame_stack * channels, h, w)`` uint8 by camera, oldest frame first,
        an episode's first frame repeated; and what ``read`` gives. ``ids``: environments whose
        images are new (all by default). ``images``: what ``look`` returned for them, if it did.
        """
        new = self.look(ids) if images is None else images
        if self._obs.frame_stack > 1:
            new = {name: self._stack(name, image, ids) for name, image in new.items()}
        if ids is None:
            self.pixels = new
        elif new:
            # Callers may still hold the previous images.
            self.pixels = {name: image.clone() for name, image in self.pixels.items()}
            for name, image in new.items():
                self.pixels[name][ids] = image
        seen: dict[str, object] = {"pixels": dict(self.pixels)} if self.pixels else {}
        return {**seen, **read(self._simulation.task, self._obs, signals)}

    def look(self, ids: Tensor | None = None) -> dict[str, Tensor]:
        """The present images of environments (all by default), by camera."""
        if not self._simulation.settings.cams or (ids is not None and not len(ids)):
            return {}
        return self._simulation.images(ids)

    def _stack(self, name: str, image: Tensor, ids: Tensor | None) -> Tensor:
        """The last ``frame_stack`` frames, the newest last."""
        begins = self._simulation.state["steps"] == 0
        begins = begins if ids is None else begins[ids]
        filled = image.repeat(1, self._obs.frame_stack, 1, 1)
        # Staggered episodes begin with steps used up, but without a frame in memory.
        if bool(begins.all()) or name not in self.pixels:
            return filled
        before = self.pixels[name] if ids is None else self.pixels[name][ids]
        moved = torch.cat((before[:, image.shape[1] :], image), 1)
        return torch.where(begins.view(-1, 1, 1, 1), filled, moved)
