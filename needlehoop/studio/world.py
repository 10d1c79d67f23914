"""What the page shows: one environment, its cameras, and who acts in it.

Any thread may wish for something at any time. One thread calls ``tick``, which does what was
wished for; nothing else touches the simulation.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from needlehoop.disturbances.axes import Disturb, disturb_of
from needlehoop.envs.build import build
from needlehoop.envs.controllers import Controller
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Moment, Simulation
from needlehoop.pictures.stills import scaled
from needlehoop.scene.cameras import View
from needlehoop.studio.players import BY_HAND, Hand, Player, hand_of, has_sliders, seen_by

Levels = Mapping[str, Mapping[str, Sequence[float]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


@dataclass(frozen=True)
class Wish:
    """What the page is to show."""

    settings: Settings
    """The scene with its views, disturbance and seed. Its own cameras do not count."""
    rendering: str
    player: str
    chosen: str
    """The view that is moved."""
    hand: Hand | None = None
    """Where a person wants the arm, if anywhere."""
    playing: bool = False
    steps: int = 0
    """Single steps that are to be taken."""
    restarts: int = 0
    """How often the episode was begun again."""


@dataclass(frozen=True)
class Frame:
    """One moment, as it is shown."""

    model: mujoco.MjModel
    """The scene; another object where it was built anew."""
    position: np.ndarray
    """Of the bodies ``(nbody, 3)``, m, world frame."""
    quaternion: np.ndarray
    """Of the bodies ``(nbody, 4)``."""
    pictures: Mapping[str, np.ndarray]
    """By view, ``(size, 2 size, 3)`` uint8: the agent's own pixels, enlarged, then ``size``."""
    status: str
    hand: Hand | None
    """Where the arm's targets are; ``None`` where it has no sliders."""
    wish: Wish


class World:
    """One environment, with the wishes of all who look at it.

    Args:
        settings: the scene; its views are those of the page.
        players: who can act, by name.
        levels: amounts of disturbances.
        rendering: what the cameras show at first.
        player: who acts at first.
        size: pixels of the finer picture.
    """

    def __init__(
        self,
        settings: Settings,
        players: Mapping[str, Player],
        levels: Levels,
        rendering: str,
        player: str,
        size: int = 256,
    ):
        self.players, self.size = players, size
        self.ladder = {f"{g}.{name}": row for g, own in levels.items() for name, row in own.items()}
        """Amounts at severities 1, 2, … by axis."""
        self._lock = threading.Lock()
        own = replace(settings, num_envs=1)
        self._wish = Wish(own, rendering, player, next(iter(settings.views)))
        self._done: Wish | None = None
        self._sims: list[Simulation] = []
        self._act: Controller | None = None
        self._moment: Moment | None = None

    @property
    def wish(self) -> Wish:
        """The last wish."""
        return self._wish

    def want(self, **changes: Any) -> None:
        """Change the wish; keys are those of ``Wish``."""
        with self._lock:
            self._wish = replace(self._wish, **changes)

    def set(self, **changes: Any) -> None:
        """Change settings of the scene; ``ValueError`` for one that is wrong."""
        with self._lock:
            self._wish = replace(self._wish, settings=replace(self._wish.settings, **changes))

    def place(self, name: str, view: View) -> None:
        """Put a camera somewhere."""
        with self._lock:
            old = self._wish.settings
            views = {**old.views, name: view}
            self._wish = replace(self._wish, settings=replace(old, views=views))

    def disturb(self, axis: str, severity: int) -> None:
        """Let one thing go wrong, from now on; at severity 0, or of no known axis, nothing."""
        row = self.ladder.get(axis, ())
        amounts = {axis: row[severity - 1]} if row and severity else {}
        self.set(disturb=disturb_of(amounts) if amounts else Disturb())

    def reach(self, tip: tuple[float, float, float], jaw: float) -> None:
        """Take over from the player, and bring the arm somewhere."""
        self.want(player=BY_HAND, hand=Hand(tip, jaw), playing=True)

    def play(self, on: bool) -> None:
        """Play or pause; an episode that is over begins again."""
        if on and self._is_over() and self.wish.player != BY_HAND:
            self.restart()
        self.want(playing=on)

    def step(self) -> None:
        """Pause, and take one step more."""
        with self._lock:
            self._wish = replace(self._wish, steps=self._wish.steps + 1, playing=False)

    def restart(self) -> None:
        """Begin the same episode again."""
        with self._lock:
            self._wish = replace(self._wish, restarts=self._wish.restarts + 1)

    def tick(self) -> Frame | None:
        """Do what was wished for, and one step if somebody plays; ``None``: nothing changed.

        A wish that cannot be fulfilled is forgotten, and the status says why.
        """
        wish, before, error = self._wish, self._done, ""
        if before is None or self._is_new(wish, before):
            try:
                self._build(wish, before)
            except ValueError as wrong:
                if before is None:
                    raise
                error = str(wrong)
                with self._lock:
                    wish = self._wish = replace(before, playing=False)
        elif wish == before and not self._has_step(wish):
            return None
        if self._has_step(wish):
            wish = self._advance(wish)
        self._done = wish
        return self._frame(wish, error or self._told())

    @staticmethod
    def _is_new(wish: Wish, before: Wish) -> bool:
        """Whether the simulations have to be made again."""
        keys = ("settings", "rendering", "player", "restarts")
        return any(getattr(wish, key) != getattr(before, key) for key in keys)

    @staticmethod
    def _has_step(wish: Wish) -> bool:
        return wish.playing or wish.steps > 0

    def _build(self, wish: Wish, before: Wish | None) -> None:
        """Make the simulations: two to look at, and one through which a policy sees.

        They take the same steps. The episode goes on where it was, unless it is another.
        """
        settings = wish.settings
        shown = replace(settings, cams=tuple(f"{wish.rendering}_{v}" for v in settings.views))
        own = [shown, replace(shown, image_size=self.size)]
        player = self.players.get(wish.player)
        seen = seen_by(player, settings) if player else None
        simulations = [build(one) for one in (*own, *([seen] if seen else []))]
        old = self._sims[0].snapshot() if before and _same_episode(wish, before) else None
        for simulation in simulations:
            moment = simulation.reset()
            if old is not None:
                # What goes wrong is new, so its own memory is that of a new episode.
                wrong = {k: v for k, v in simulation.snapshot().items() if k == "disturbance"}
                kept = {k: v for k, v in old.items() if k != "disturbance"}
                simulation.restore({**kept, **wrong})
                moment = simulation.look()
            self._moment = moment
        self._act = player.make(simulations[-1]) if player else None
        self._sims = simulations

    def _advance(self, wish: Wish) -> Wish:
        """Take a step; returns the wish with that step done, and pauses where an episode ends."""
        by_hand = wish.player == BY_HAND
        if by_hand or not self._is_over():
            assert self._moment is not None
            if by_hand:
                action = (wish.hand or hand_of(self._sims[0])).act(self._sims[0])
            else:
                assert self._act is not None
                action = self._act(self._moment.signals)
            self._moment, *_ = [simulation.step(action) for simulation in self._sims]
        ends = self._is_over() and not by_hand
        with self._lock:
            # Others may have wished for more meanwhile; that is done at the next tick.
            done = {"steps": max(0, wish.steps - 1), "playing": wish.playing and not ends}
            if self._wish == wish:
                self._wish = replace(wish, **done)
            elif ends:
                self._wish = replace(self._wish, playing=False)
        return replace(wish, **done)

    def _is_over(self) -> bool:
        moment = self._moment
        return moment is not None and bool(moment.terminated | moment.truncated)

    def _frame(self, wish: Wish, status: str) -> Frame:
        small, fine = self._sims[:2]
        data = small.engine.data(0)
        kind = wish.settings.renderings[wish.rendering]
        images, finer = small.images(), fine.images()
        pictures = {
            camera.view: np.hstack(
                [
                    np.asarray(scaled(shown[camera.name][0].numpy(), kind, self.size))
                    for shown in (images, finer)
                ]
            )
            for camera in small.settings.cameras
        }
        return Frame(
            model=small.engine.model,
            position=data.xpos.copy(),
            quaternion=data.xquat.copy(),
            pictures=pictures,
            status=status,
            hand=hand_of(small) if has_sliders(wish.settings) else None,
            wish=wish,
        )

    def _told(self) -> str:
        """The moment in words."""
        moment = self._moment
        assert moment is not None
        facts = [name for name, fact in moment.facts.items() if bool(fact)]
        limit = self._sims[0].episode.max_steps
        return f"step {int(moment.steps)} of {limit}; {', '.join(facts) or 'no fact is true'}"


def _same_episode(wish: Wish, before: Wish) -> bool:
    """Whether an episode goes on: cameras, disturbance and player may be others."""
    keys = ("task", "episode", "seed", "psm")
    same = all(getattr(wish.settings, key) == getattr(before.settings, key) for key in keys)
    return same and wish.restarts == before.restarts
