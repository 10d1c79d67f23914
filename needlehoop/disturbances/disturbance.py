"""What goes wrong in a batch of environments, episode by episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.disturbances import camera, delivery, picture, robot, scene
from needlehoop.disturbances.axis import EPISODE, THING, VIEW, Drawn, When
from needlehoop.disturbances.chance import uniform
from needlehoop.disturbances.config import AXES
from needlehoop.disturbances.sensors import Sensors, Spoiler
from needlehoop.engines.contract import ZOOM

_CAMERA = [f"camera.{name}" for name in camera.AXES]
_PICTURE = [f"picture.{name}" for name in picture.AXES]
_DELIVERY = [f"picture.{name}" for name in delivery.AXES]
_LOOKS = [f"scene.{name}" for name in scene.AXES]
_PHYSICS = ("robot.friction", "robot.mass")


class Disturbance:
    """Disturbs ``n`` environments. What it does depends on seed, environment, episode and step.

    Args:
        amounts: of the axes that may do something, by their keys in ``AXES``.
        model: the scene.
        things: number of the thing that each geom is a part of ``(ngeom,)``.
        views: names of the cameras that are looked through.
        target: what they look at ``(3,)``, m.
        size: side of their images, px.
        max_steps: of an episode.
        num_envs: ``n``.
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
        names = (model.geom(i).name for i in range(model.ngeom))
        self._strange = [i for i, name in enumerate(names) if name.startswith(scene.STRANGE)]
        self._max_steps = max_steps
        seen = views and any(key in amounts for key in _PICTURE)
        self._sensors = Sensors(num_envs, views, size) if seen else None
        self.level = 1.0
        """Share of the amounts in episodes that begin from now on."""
        n, parts = num_envs, {EPISODE: (), VIEW: (len(views),), THING: (1 + things.max(),)}
        self._amounts = {key: np.full(n, float(amount)) for key, amount in amounts.items()}
        self._drawn = {
            key: Drawn(np.zeros((n, *parts[axis.per], axis.size)),
                       np.zeros((n, *parts[axis.per], axis.free)))
            for key, axis in ((key, AXES[key]) for key in amounts)
        }  # fmt: skip
        self._numbers = {name: np.zeros(n, np.int64) for name in ("envs", "episodes", "steps")}
        self._levels = np.ones(n)
        self._seed = 0
        late = int(amounts.get("robot.late", 0))
        self._sent: np.ndarray | None = None
        self._commands = late + 1
        self._pictures = int(amounts.get("picture.late", 0)) + 1
        self._kept: dict[str, np.ndarray] = {}

    def deal(self, ids: np.ndarray, amounts: Mapping[str, np.ndarray]) -> None:
        """Give environments amounts of their own, ``(k,)`` by key, from their next episode on."""
        for key, values in self._amounts.items():
            values[ids] = amounts.get(key, 0.0)

    def begin(
        self, ids: np.ndarray, seed: int, envs: np.ndarray, episodes: np.ndarray, control: Tensor
    ) -> None:
        """Episodes begin.

        Args:
            ids: rows of the batch ``(k,)``.
            seed: of all environments.
            envs: their indices among all of the seed ``(k,)``.
            episodes: counts of the episodes that each had before ``(k,)``.
            control: commands that hold their starts ``(k, nu)``.
        """
        self._seed = seed
        for name, values in (("envs", envs), ("episodes", episodes), ("steps", 0)):
            self._numbers[name][ids] = values
        self._levels[ids] = self.level
        self._draw(ids)
        if "robot.late" in self._drawn or "robot.lost" in self._drawn:
            if self._sent is None:
                self._sent = np.zeros((self._commands, len(self._levels), control.shape[1]))
            self._sent[:, ids] = control.numpy()

    def _draw(self, ids: np.ndarray) -> None:
        keys = (self._seed, self._numbers["envs"][ids], self._numbers["episodes"][ids])
        for key, kept in self._drawn.items():
            axis = AXES[key]
            shape = (len(ids), *kept.amount.shape[1:-1], axis.size + axis.free)
            numbers = uniform(key, int(np.prod(shape[1:])), *keys).reshape(shape)
            drawn = axis.drawn(numbers, self._levels[ids] * self._amounts[key][ids])
            kept.amount[ids], kept.free[ids] = drawn
        if self._sensors is not None:
            flaws = picture.flawless(len(ids), len(self._views))
            for key in _PICTURE:
                if key in self._drawn:
                    flaws = AXES[key].apply(flaws, self._drawn[key][ids])
            self._sensors.set(ids, flaws)

    def _when(self) -> When:
        steps = self._numbers["steps"]
        return When(steps, np.minimum(1.0, steps / self._max_steps))

    def _acting(self, keys: list[str]) -> list[str]:
        """Of some axes those that are to act in some environment."""
        return [key for key in keys if key in self._drawn and self._amounts[key].any()]

    # What the robot does.

    def physics(self, ids: np.ndarray) -> tuple[Tensor, Tensor] | None:
        """Factors of friction and mass ``(k,)``; ``None``: they stay as they are."""
        if not any(key in self._drawn for key in _PHYSICS):
            return None
        found = (
            robot.factor(self._drawn[key][ids]) if key in self._drawn else np.ones(len(ids))
            for key in _PHYSICS
        )
        friction, mass = (torch.from_numpy(one) for one in found)
        return friction, mass

    @property
    def offset(self) -> Tensor | None:
        """How far the tips stand from where they were told to ``(n, 3)``, m; ``None``: not."""
        drawn = self._drawn.get("robot.offset")
        return None if drawn is None else torch.from_numpy(robot.offset(drawn))

    def command(self, control: Tensor) -> Tensor:
        """A step begins: the commands ``(n, nu)`` that arrive at the servos."""
        self._numbers["steps"] += 1
        if self._sent is None:
            return control
        sent, rows, steps = self._sent, np.arange(len(control)), self._numbers["steps"]
        given = control.numpy()
        if "robot.lost" in self._drawn:
            keys = (self._numbers[name] for name in ("envs", "episodes", "steps"))
            chance = uniform("robot.lost.now", 1, self._seed, *keys)[:, 0]
            gone = robot.lost(self._drawn["robot.lost"], chance)
            # The servos hold the command before it.
            before = sent[(steps - 1) % self._commands, rows]
            given = np.where(gone[:, None], before, given)
        sent[steps % self._commands, rows] = given
        late = robot.late(self._drawn["robot.late"]) if "robot.late" in self._drawn else 0
        return torch.from_numpy(sent[(steps - late) % self._commands, rows])

    # What the cameras show.

    def optics(self, fields: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """The fields of all environments as they are drawn; see ``engines.contract.Optics``."""
        n, at = len(self._levels), self._cameras
        found = dict(fields)
        own = self._acting(_CAMERA)
        if own:
            places = fields["cam_xpos"].reshape(n, -1, 3).copy()
            turns = fields["cam_xmat"].reshape(n, -1, 3, 3).copy()
            zoom = np.ones(turns.shape[:2])
            cameras = camera.Cameras(places[:, at], turns[:, at], zoom[:, at])
            when = self._when()
            for key in own:
                cameras = AXES[key].apply(cameras, self._drawn[key], when)
            places[:, at], turns[:, at], zoom[:, at] = cameras
            found |= {"cam_xpos": places, "cam_xmat": turns}
            found[ZOOM] = zoom
        own = self._acting(_LOOKS)
        if own:
            found |= self._look(fields, own)
        return found

    def _look(self, fields: Mapping[str, np.ndarray], own: list[str]) -> dict[str, np.ndarray]:
        n, things = len(self._levels), 1 + int(self._things.max())
        lamps = fields["light_xdir"].reshape(n, -1, 3)
        hidden = np.tile((*self._target[:2], scene.HIDDEN), (n, len(self._strange), 1))
        looks = scene.Looks(
            lamps, np.ones((n, 1)), np.ones((n, things, 3)), np.zeros((n, things)),
            np.zeros((n, 1, 3)), hidden,
        )  # fmt: skip
        for key in own:
            looks = AXES[key].apply(looks, self._drawn[key])
        places = fields["geom_xpos"].reshape(n, -1, 3).copy()
        places[:, self._strange] = looks.objects
        found = {"light_xdir": looks.lamps, "geom_xpos": places}
        if {key.removeprefix("scene.") for key in own} & set(scene.RASTERISED):
            found |= {
                "geom_tint": looks.tint[:, self._things],
                "geom_sheen": looks.sheen[:, self._things],
                "lamp_strength": looks.strength,
                "table_grain": looks.grain,
            }
        return found

    def spoiler(self, ids: Tensor | None) -> Spoiler | None:
        """What the cameras of environments ``ids`` (all by default) make of their frames."""
        if self._sensors is None or not self._acting(_PICTURE):
            return None
        rows = np.arange(len(self._levels)) if ids is None else ids.numpy()
        keys = (self._numbers[name][rows] for name in ("envs", "episodes", "steps"))
        places = uniform("picture", 3 * len(self._views), self._seed, *keys)
        return self._sensors.spoiler(rows, places)

    def deliver(
        self, images: dict[str, Tensor], views: Mapping[str, str], ids: Tensor | None
    ) -> dict[str, Tensor]:
        """The images that arrive now.

        Args:
            images: taken now ``(k, c, h, w)`` by camera.
            views: of the cameras, by name.
            ids: environments ``(k,)``; all by default.
        """
        own = [key for key in _DELIVERY if key in self._drawn]
        if not own:
            return images
        rows = np.arange(len(self._levels)) if ids is None else ids.numpy()
        steps = self._numbers["steps"][rows]
        when = When(steps, steps / self._max_steps)
        old = np.zeros((len(rows), len(self._views)), int)
        failing = {key: np.zeros(old.shape, bool) for key in ("picture.frozen", "picture.black")}
        for key in own:
            drawn = self._drawn[key][rows]
            if key == "picture.late":
                old = delivery.late(drawn, when)
            else:
                failing[key] = delivery.fails(drawn, when, len(self._views), self._max_steps)
        found = {}
        for name, image in images.items():
            at = self._views.index(views[name])
            if name not in self._kept:
                shape = (self._pictures + 1, len(self._levels), *image.shape[1:])
                self._kept[name] = np.zeros(shape, np.uint8)
            # The last pictures by step, and after them what arrived last.
            kept, last = self._kept[name], self._pictures
            kept[steps % last, rows] = image.numpy()
            seen = kept[(steps - old[:, at]) % last, rows]
            frozen = failing["picture.frozen"][:, at]
            seen[frozen] = kept[last, rows[frozen]]
            seen[failing["picture.black"][:, at]] = 0
            kept[last, rows] = seen
            found[name] = torch.from_numpy(seen)
        return found

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides the future."""
        sent = {} if self._sent is None else {"sent": torch.from_numpy(self._sent.copy())}
        return {
            "seed": self._seed,
            **{name: torch.from_numpy(one.copy()) for name, one in self._numbers.items()},
            "levels": torch.from_numpy(self._levels.copy()),
            **sent,
            "kept": {name: torch.from_numpy(one.copy()) for name, one in self._kept.items()},
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot`` of a disturbance with the same amounts."""
        self._seed = snapshot["seed"]
        for name, one in self._numbers.items():
            one[:] = snapshot[name].numpy()
        self._levels[:] = snapshot["levels"].numpy()
        self._sent = snapshot["sent"].numpy().copy() if "sent" in snapshot else None
        self._kept = {name: one.numpy().copy() for name, one in snapshot["kept"].items()}
        self._draw(np.arange(len(self._levels)))
