"""What the page shows: one environment, its cameras, and who acts in it.

Any thread may wish for something at any time. One thread calls ``tick``, which does what was
wished for; nothing else touches the simulation.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from needlehoop.disturbances.axes import Levels, disturb_of, ladder
from needlehoop.envs.build import build
from needlehoop.envs.controllers import Controller
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation, StepResult
from needlehoop.pictures.stills import scaled
from needlehoop.scene.cameras import View
from needlehoop.scene.image_size import scaled_to
from needlehoop.studio.players import BY_HAND, Hand, Player, has_sliders


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
    ahead: float = 0.0
    """Steps that are to be taken: infinitely many while somebody plays."""
    restarts: int = 0
    """How often the episode was begun again."""

    @property
    def scene_key(self) -> tuple[Any, ...]:
        """Changing any of these makes other simulations."""
        return self.settings, self.rendering, self.player, self.restarts

    @property
    def episode_key(self) -> tuple[Any, ...]:
        """Changing any of these begins another episode; a new disturbance does not."""
        s = self.settings
        return s.task, s.episode, s.seed, s.psm, self.restarts


@dataclass(frozen=True)
class Frame:
    """One moment, as it is shown."""

    model: mujoco.MjModel
    position: np.ndarray
    """Of the bodies ``(nbody, 3)``, m, world frame."""
    quaternion: np.ndarray
    """Of the bodies ``(nbody, 4)``."""
    pictures: Mapping[str, np.ndarray]
    """By view, ``(h, 2 w, 3)`` uint8: the agent's own pixels, enlarged, then finer ones."""
    status: str
    hand: Hand | None
    """Where the arm's targets are; ``None`` where it has no sliders."""
    wish: Wish


class World:
    """One environment, with the wishes of all who look at it.

    The views of ``settings`` are those of the page. ``players`` can act, by name. ``player`` does
    at first, and ``rendering`` is shown. ``size``: pixels of the finer picture's longer side.
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
        self.ladder = ladder(levels)
        """Amounts at severities 0, 1, 2, … by axis."""
        self._lock = threading.Lock()
        env = replace(settings, num_envs=1)
        self.wish = Wish(env, rendering, player, next(iter(settings.views)))
        """The last wish."""
        self._done: Wish | None = None
        self._sims: list[Simulation] = []
        self._act: Controller | None = None
        self._moment: Any = None

    def want(self, **changes: Any) -> None:
        """Change the wish; keys are those of ``Wish``."""
        with self._lock:
            self.wish = replace(self.wish, **changes)

    def set(self, **changes: Any) -> None:
        """Change settings of the scene; ``ValueError`` for one that is wrong."""
        with self._lock:
            self.wish = replace(self.wish, settings=replace(self.wish.settings, **changes))

    def place(self, name: str, view: View) -> None:
        self.set(views={**self.wish.settings.views, name: view})

    def disturb(self, axis: str, severity: int) -> None:
        """Apply one disturbance from now on; severity 0 or an unknown axis: none."""
        row = self.ladder.get(axis, (0.0,))
        amount = row[min(severity, len(row) - 1)]
        self.set(disturb=disturb_of({axis: amount} if amount else {}))

    def reach(self, hand: Hand) -> None:
        """Take over from the player, and bring the arm somewhere."""
        self.want(player=BY_HAND, hand=hand, ahead=math.inf)

    def play(self, on: bool) -> None:
        """Play or pause; an episode that is over begins again."""
        if on and self._is_over():
            self.restart()
        self.want(ahead=math.inf if on else 0.0)

    def step(self) -> None:
        """Pause, and take one step more if the episode goes on."""
        self.want(ahead=0.0 if self._is_over() else 1.0)

    def restart(self) -> None:
        self.want(restarts=self.wish.restarts + 1)

    def tick(self) -> Frame | None:
        """Do what was wished for, and one step if some are ahead; ``None``: nothing changed."""
        wish, before = self.wish, self._done
        if wish == before and not wish.ahead:
            return None
        if before is None or wish.scene_key != before.scene_key:
            self._build(wish, before)
        if wish.ahead:
            wish = self._advance(wish)
        self._done = wish
        return self._frame(wish)

    def _build(self, wish: Wish, before: Wish | None) -> None:
        """Make the simulations: two to look at, and one through which a policy sees.

        They take the same steps. The episode goes on where it was, unless it is another.
        """
        settings, player = wish.settings, self.players.get(wish.player)
        shown = replace(settings, cams=tuple(f"{wish.rendering}_{v}" for v in settings.views))
        envs = [shown, replace(shown, image_size=scaled_to(settings.image_size, self.size))]
        envs += [replace(settings, **player.sees)] if player and player.sees else []
        goes_on = before is not None and wish.episode_key == before.episode_key
        old = self._sims[0].snapshot() if goes_on else {}
        old.pop("disturbance", None)
        self._sims = [build(env) for env in envs]
        for simulation in self._sims:
            self._moment = simulation.reset()
            if goes_on:
                # What goes wrong is new: it begins here.
                simulation.restore({**simulation.snapshot(), **old})
                self._moment = simulation.look()
        self._act = player.make(self._sims[-1]) if player else None

    def _advance(self, wish: Wish) -> Wish:
        """Take a step; returns the wish with that step done, and pauses where an episode ends."""
        simulation = self._sims[0]
        if self._act is None:
            hand = wish.hand or Hand.of(simulation.state)
            action = hand.act(simulation.episode, simulation.state)
        else:
            action = self._act(self._moment.signals)
        self._moment, *_ = [simulation.step(action) for simulation in self._sims]
        ahead = 0.0 if self._is_over() else max(0.0, wish.ahead - 1)
        with self._lock:
            # Somebody may have paused meanwhile.
            if self.wish.ahead == wish.ahead:
                self.wish = replace(self.wish, ahead=ahead)
        return replace(wish, ahead=ahead)

    def _is_over(self) -> bool:
        """Whether the episode is over. A person who moves the arm may go on after its end."""
        moment: StepResult | None = self._moment
        is_over = moment is not None and bool(moment.terminated | moment.truncated)
        return is_over and self.wish.player != BY_HAND

    def _frame(self, wish: Wish) -> Frame:
        small, fine = self._sims[:2]
        data, kind = small.engine.data(0), wish.settings.renderings[wish.rendering]
        seen, pictures = [simulation.images() for simulation in (small, fine)], {}
        for camera in small.settings.cameras:
            images = [pixels[camera.name][0].cpu().numpy() for pixels in seen]
            shown = [np.asarray(scaled(image, kind, self.size)) for image in images]
            pictures[camera.view] = np.hstack(shown)
        facts = [name for name, fact in self._moment.facts.items() if bool(fact)]
        step = f"step {int(self._moment.steps)} of {small.episode.max_steps}"
        return Frame(
            model=small.engine.model,
            position=data.xpos.copy(),
            quaternion=data.xquat.copy(),
            pictures=pictures,
            status=f"{step}; {', '.join(facts) or 'no fact is true'}",
            hand=Hand.of(small.state) if has_sliders(wish.settings) else None,
            wish=wish,
        )
