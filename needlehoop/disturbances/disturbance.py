"""Disturbs a batch of environments, episode by episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.disturbances import optics
from needlehoop.disturbances.axes import AXES, EPISODE, RASTERISED, THING, VIEW, Drawn, uniform
from needlehoop.disturbances.sensors import Sensors, Spoiler, flaws

_DELIVERY = ("picture.late", "picture.frozen", "picture.black")
_SENSORS = tuple(key for key in AXES if key.startswith("picture.") and key not in _DELIVERY)


class Disturbance:
    """Disturbs ``n`` environments, depending on seed, environment, episode and step alone.

    Args:
        amounts: of the axes that may do something, by their keys in ``AXES``.
        things: number of the thing that each geom belongs to ``(ngeom,)``.
        views: names of the chosen cameras' views.
        target: the point that they look at ``(3,)``, m.
        size: side of their images, px.
    """

    def __init__(
        self,
        amounts: Mapping[str, float],
        model: mujoco.MjModel,
        things: np.ndarray,
        views: tuple[str, ...],
        target: np.ndarray,
        size: int,
        max_steps: int,
        num_envs: int,
    ):
        self._views, self._things, self._target = views, things, target
        self._cameras = [model.camera(view).id for view in views]
        self._mounted = model.cam_bodyid[self._cameras] > 0
        names = (model.geom(i).name for i in range(model.ngeom))
        self._strange = [i for i, name in enumerate(names) if name.startswith(optics.STRANGE)]
        self._max_steps = max_steps
        self.level = 1.0
        """Share of the amounts in episodes that begin from now on."""
        n, parts = num_envs, {EPISODE: (), VIEW: (len(views),), THING: (1 + things.max(),)}
        self._amounts = {key: np.full(n, float(amount)) for key, amount in amounts.items()}
        # Of all axes; zeros where there is no amount.
        self._drawn = {
            key: Drawn(*(np.zeros((n, *parts[axis.per], k)) for k in (axis.size, axis.free)))
            for key, axis in AXES.items()
        }
        self._numbers = {name: np.zeros(n, np.int64) for name in ("envs", "episodes", "steps")}
        self._levels = np.ones(n)
        self._seed = 0
        self._sensors = Sensors(n, views, size) if views and self._may(*_SENSORS) else None
        self._sent: np.ndarray | None = None
        if self._may("robot.late", "robot.lost"):
            self._sent = np.zeros((int(amounts.get("robot.late", 0)) + 1, n, model.nu))
        self._pictures = int(amounts.get("picture.late", 0)) + 1
        self._kept: dict[str, np.ndarray] = {}

    def _may(self, *keys: str) -> bool:
        """Whether one of these axes may ever do something."""
        return any(key in self._amounts for key in keys)

    def _does(self, *begins: str) -> bool:
        """Whether an axis whose key begins in such a way does something in some environment."""
        return any(one.any() for key, one in self._amounts.items() if key.startswith(begins))

    def deal(self, ids: np.ndarray, amounts: Mapping[str, np.ndarray]) -> None:
        """Give environments amounts of their own, ``(k,)`` by key, from their next episode on."""
        for key, values in self._amounts.items():
            values[ids] = amounts.get(key, 0.0)

    def begin(
        self, ids: np.ndarray, seed: int, envs: np.ndarray, episodes: np.ndarray, control: Tensor
    ) -> None:
        """Episodes begin in rows ``ids`` ``(k,)`` of the batch.

        ``envs``: their indices ``(k,)`` among all of the seed. ``episodes``: how many each had
        before ``(k,)``. ``control``: commands ``(k, nu)`` that hold their starts.
        """
        self._seed = seed
        for name, values in (("envs", envs), ("episodes", episodes), ("steps", 0)):
            self._numbers[name][ids] = values
        self._levels[ids] = self.level
        self._draw(ids)
        if self._sent is not None:
            self._sent[:, ids] = control.numpy()

    def _draw(self, ids: np.ndarray) -> None:
        keys = (self._seed, self._numbers["envs"][ids], self._numbers["episodes"][ids])
        for key, amounts in self._amounts.items():
            axis, kept = AXES[key], self._drawn[key]
            shape = (len(ids), *kept.amount.shape[1:-1], axis.size + axis.free)
            numbers = uniform(key, int(np.prod(shape[1:])), *keys).reshape(shape)
            drawn = axis.drawn(numbers, self._levels[ids] * amounts[ids])
            kept.amount[ids], kept.free[ids] = drawn
        if self._sensors is not None:
            self._sensors.set(ids, **flaws(self._of(ids, _SENSORS)))

    def _of(self, ids: np.ndarray, keys: Sequence[str]) -> dict[str, Drawn]:
        """What environments drew for some axes."""
        return {key: Drawn(*(one[ids] for one in self._drawn[key])) for key in keys}

    # What the robot does.

    def physics(self, ids: np.ndarray) -> tuple[Tensor, Tensor] | None:
        """Factors of friction and mass ``(k,)``; ``None``: they stay as they are."""
        if not self._may("robot.friction", "robot.mass"):
            return None
        friction, mass = (
            torch.from_numpy(1.0 + self._drawn[key].amount[ids, 0])
            for key in ("robot.friction", "robot.mass")
        )
        return friction, mass

    @property
    def offset(self) -> Tensor | None:
        """Offsets of the tips from their targets ``(n, 3)``, m; ``None``: no such axis."""
        if not self._may("robot.offset"):
            return None
        return torch.from_numpy(self._drawn["robot.offset"].amount)

    def command(self, control: Tensor) -> Tensor:
        """A step begins: the commands ``(n, nu)`` that arrive at the servos."""
        self._numbers["steps"] += 1
        if self._sent is None:
            return control
        sent, rows, steps = self._sent, np.arange(len(control)), self._numbers["steps"]
        keys = (self._numbers[name] for name in ("envs", "episodes", "steps"))
        chance = uniform("robot.lost.now", 1, self._seed, *keys)
        lost = chance < self._drawn["robot.lost"].amount
        # The servos hold the command before a lost one.
        before = sent[(steps - 1) % len(sent), rows]
        sent[steps % len(sent), rows] = np.where(lost, before, control.numpy())
        late = self._drawn["robot.late"].amount[:, 0].astype(int)
        return torch.from_numpy(sent[(steps - late) % len(sent), rows])

    # What the cameras show.

    def optics(self, fields: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """The fields of all environments as they are drawn; see ``engines.contract.Optics``."""
        n, at, found = len(self._levels), self._cameras, dict(fields)
        if self._does("camera."):
            places = fields["cam_xpos"].reshape(n, -1, 3).copy()
            turns = fields["cam_xmat"].reshape(n, -1, 3, 3).copy()
            zoom = np.ones(turns.shape[:2])
            time = np.minimum(1.0, self._numbers["steps"] / self._max_steps)
            own = optics.cameras(places[:, at], turns[:, at], self._drawn, time, self._mounted)
            places[:, at], turns[:, at], zoom[:, at] = own
            found |= {"cam_xpos": places, "cam_xmat": turns, "cam_zoom": zoom}
        if self._does("scene."):
            places = fields["geom_xpos"].reshape(n, -1, 3).copy()
            strange = self._drawn["scene.objects"]
            places[:, self._strange] = optics.objects(strange, len(self._strange), self._target)
            shining = optics.lamps(fields["light_xdir"].reshape(n, -1, 3), self._drawn)
            found |= {"geom_xpos": places, "light_xdir": shining}
        if self._does(*(key for key in RASTERISED if key.startswith("scene."))):
            found |= optics.looks(self._drawn, self._things)
        return found

    def spoiler(self, ids: Tensor | None) -> Spoiler | None:
        """A function that adds flaws to frames of environments ``ids`` (all by default)."""
        if self._sensors is None or not self._does(*_SENSORS):
            return None
        rows = np.arange(len(self._levels)) if ids is None else ids.numpy()
        keys = (self._numbers[name][rows] for name in ("envs", "episodes", "steps"))
        places = uniform("picture", 3 * len(self._views), self._seed, *keys)
        return self._sensors.spoiler(rows, places)

    def deliver(
        self, images: dict[str, Tensor], views: Mapping[str, str], ids: Tensor | None
    ) -> dict[str, Tensor]:
        """The images that arrive now: late, frozen or black ones.

        ``images``: taken now ``(k, c, h, w)`` in environments ``ids`` (all by default), by camera.
        ``views``: of the cameras, by name.
        """
        if not self._may(*_DELIVERY):
            return images
        rows = np.arange(len(self._levels)) if ids is None else ids.numpy()
        steps, last = self._numbers["steps"][rows], self._pictures
        late, *fails = self._of(rows, _DELIVERY).values()
        old = np.minimum(late.amount[..., 0].astype(int), steps[:, None])
        frozen, black = (failing(one, steps, len(self._views), self._max_steps) for one in fails)
        found = {}
        for name, image in images.items():
            at = self._views.index(views[name])
            if name not in self._kept:
                shape = (last + 1, len(self._levels), *image.shape[1:])
                self._kept[name] = np.zeros(shape, np.uint8)
            # The last pictures by step, and after them what arrived last.
            kept = self._kept[name]
            kept[steps % last, rows] = image.numpy()
            seen = kept[(steps - old[:, at]) % last, rows]
            seen[frozen[:, at]] = kept[last, rows[frozen[:, at]]]
            seen[black[:, at]] = 0
            kept[last, rows] = seen
            found[name] = torch.from_numpy(seen)
        return found

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides the future."""
        sent = {} if self._sent is None else {"sent": torch.from_numpy(self._sent.copy())}
        return {
            "seed": torch.tensor(self._seed),
            **{name: torch.from_numpy(one.copy()) for name, one in self._numbers.items()},
            "levels": torch.from_numpy(self._levels.copy()),
            **sent,
            "kept": {name: torch.from_numpy(one.copy()) for name, one in self._kept.items()},
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot`` of a disturbance with the same amounts."""
        self._seed = int(snapshot["seed"])
        for name, one in self._numbers.items():
            one[:] = snapshot[name].numpy()
        self._levels[:] = snapshot["levels"].numpy()
        self._sent = snapshot["sent"].numpy().copy() if "sent" in snapshot else None
        self._kept = {name: one.numpy().copy() for name, one in snapshot["kept"].items()}
        self._draw(np.arange(len(self._levels)))


def failing(drawn: Drawn, steps: np.ndarray, views: int, max_steps: int) -> np.ndarray:
    """Which view fails after ``steps`` ``(k,)``, as ``(k, views)`` bool: at most one of them.

    ``drawn``: for how many steps; then when it begins, and which view.
    """
    # It begins to fail in the first quarter of an episode's time.
    begins = 1 + np.floor(drawn.free[:, 0] * 0.25 * max_steps)
    now = (steps >= begins) & (steps < begins + drawn.amount[:, 0])
    return now[:, None] & (np.floor(drawn.free[:, 1] * views)[:, None] == np.arange(views))
