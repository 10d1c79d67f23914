"""Disturbs a batch of environments, episode by episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.disturbances import optics
from needlehoop.disturbances.axes import AXES, EPISODE, RASTERISED, THING, VIEW, Drawn, uniform
from needlehoop.disturbances.sensors import Sensors, Spoiler, flaws
from needlehoop.scene.image_size import ImageSize

_DELIVERY = ("picture.late", "picture.frozen", "picture.black")
_SENSORS = tuple(key for key in AXES if key.startswith("picture.") and key not in _DELIVERY)


class Disturbance:
    """Disturbs ``n`` environments, depending on seed, environment, episode and step alone.

    What an episode draws is worked out on the CPU when it begins, and kept on the engine's device,
    where it acts in every step.

    Args:
        amounts: of the axes that may do something, by their keys in ``AXES``.
        things: number of the thing that each geom belongs to ``(ngeom,)``.
        views: names of the chosen cameras' views.
        target: the point that they look at ``(3,)``, m.
        size: of their images.
        device: the engine's.
    """

    def __init__(
        self,
        amounts: Mapping[str, float],
        model: mujoco.MjModel,
        things: np.ndarray,
        views: tuple[str, ...],
        target: np.ndarray,
        size: ImageSize,
        max_steps: int,
        num_envs: int,
        device: torch.device,
    ):
        self._views, self._target, self._device = views, target, device
        cameras = [model.camera(view).id for view in views]
        self._cameras = torch.tensor(cameras, dtype=torch.int64, device=device)
        self._mounted = torch.from_numpy(model.cam_bodyid[cameras] > 0).to(device)
        self._things = torch.from_numpy(things).to(device)
        names = (model.geom(i).name for i in range(model.ngeom))
        strange = [i for i, name in enumerate(names) if name.startswith(optics.STRANGE)]
        self._strange = torch.tensor(strange, dtype=torch.int64, device=device)
        self._max_steps = max_steps
        self.level = 1.0
        """Share of the amounts in episodes that begin from now on."""
        n, parts = num_envs, {EPISODE: (), VIEW: (len(views),), THING: (1 + things.max(),)}
        full: Any = {"dtype": torch.float64}
        self._amounts = {key: torch.full((n,), amount, **full) for key, amount in amounts.items()}
        self._levels = torch.ones(n, dtype=torch.float64)
        # Of all axes; zeros where there is no amount.
        double: Any = {"dtype": torch.float64, "device": device}
        self._drawn = {
            key: Drawn(
                *(torch.zeros(n, *parts[axis.per], k, **double) for k in (axis.size, axis.free))
            )
            for key, axis in AXES.items()
        }
        calm = {key: Drawn(*(x.cpu() for x in drawn)) for key, drawn in self._drawn.items()}
        self._moved = optics.Moved(*(one.to(device) for one in optics.moved(calm)))
        lying = optics.objects(calm["scene.objects"], len(strange), target)
        self._lying = lying.to(device)
        self._numbers = {
            name: torch.zeros(n, dtype=torch.int64, device=device)
            for name in ("envs", "episodes", "steps")
        }
        self._seed = 0
        self._sensors = None
        if views and self._may(*_SENSORS):
            self._sensors = Sensors(n, views, size, device)
        self._sent: Tensor | None = None
        if self._may("robot.late", "robot.lost"):
            self._sent = torch.zeros(int(amounts.get("robot.late", 0)) + 1, n, model.nu, **double)
        self._pictures = int(amounts.get("picture.late", 0)) + 1
        self._kept: dict[str, Tensor] = {}

    def _may(self, *keys: str) -> bool:
        """Whether one of these axes may ever do something."""
        return any(key in self._amounts for key in keys)

    def _does(self, *begins: str) -> bool:
        """Whether an axis whose key begins so does something in any environment."""
        return any(bool(one.any()) for key, one in self._amounts.items() if key.startswith(begins))

    def deal(self, ids: Tensor, amounts: Mapping[str, Tensor]) -> None:
        """Give environments ``ids`` amounts of their own, ``(k,)`` by key, from their next episode
        on."""
        for key, values in self._amounts.items():
            values[ids.cpu()] = amounts[key].double().cpu() if key in amounts else 0.0

    def begin(
        self, ids: Tensor, seed: int, envs: np.ndarray, episodes: np.ndarray, control: Tensor
    ) -> None:
        """Episodes begin in rows ``ids`` ``(k,)`` of the batch.

        ``envs``: their indices ``(k,)`` among all of the seed. ``episodes``: how many each had
        before ``(k,)``. ``control``: commands ``(k, nu)`` that hold their starts.
        """
        self._seed = seed
        keys = torch.from_numpy(envs), torch.from_numpy(episodes)
        for name, values in zip(("envs", "episodes"), keys, strict=True):
            self._numbers[name][ids] = values.to(self._device)
        self._numbers["steps"][ids] = 0
        self._levels[ids.cpu()] = self.level
        self._draw(ids, *keys)
        if self._sent is not None:
            self._sent[:, ids] = control

    def _draw(self, ids: Tensor, envs: Tensor, episodes: Tensor) -> None:
        """Work out what episodes draw; ``envs`` and ``episodes`` ``(k,)`` are on the CPU."""
        rows, fresh = ids.cpu(), {}
        for key, drawn in self._drawn.items():
            axis, shape = AXES[key], (len(rows), *drawn.amount.shape[1:-1])
            if key in self._amounts:
                each = (*shape, axis.size + axis.free)
                numbers = uniform(key, int(np.prod(each[1:])), self._seed, envs, episodes)
                amounts = self._levels[rows] * self._amounts[key][rows]
                fresh[key] = axis.drawn(numbers.reshape(each), amounts)
                for kept, value in zip(drawn, fresh[key], strict=True):
                    kept[ids] = value.to(self._device)
            else:
                sizes = (axis.size, axis.free)
                fresh[key] = Drawn(*(torch.zeros(*shape, k).double() for k in sizes))
        for kept, value in zip(self._moved, optics.moved(fresh), strict=True):
            kept[ids] = value.to(self._device)
        count = self._lying.shape[1]
        lying = optics.objects(fresh["scene.objects"], count, self._target)
        self._lying[ids] = lying.to(self._device)
        if self._sensors is not None:
            self._sensors.set(rows, **flaws({key: fresh[key] for key in _SENSORS}))

    def _rows(self, ids: Tensor | None) -> Tensor:
        return torch.arange(len(self._levels), device=self._device) if ids is None else ids

    # What the robot does.

    def physics(self, ids: Tensor) -> tuple[Tensor, Tensor] | None:
        """Factors of friction and mass ``(k,)``; ``None``: they stay as they are."""
        if not self._may("robot.friction", "robot.mass"):
            return None
        friction, mass = (
            1.0 + self._drawn[key].amount[ids, 0] for key in ("robot.friction", "robot.mass")
        )
        return friction, mass

    @property
    def offset(self) -> Tensor | None:
        """Offsets of the tips from their targets ``(n, 3)``, m; ``None``: no such axis."""
        return self._drawn["robot.offset"].amount if self._may("robot.offset") else None

    def command(self, control: Tensor) -> Tensor:
        """A step begins: the commands ``(n, nu)`` that arrive at the servos."""
        self._numbers["steps"] += 1
        if self._sent is None:
            return control
        sent, rows, steps = self._sent, self._rows(None), self._numbers["steps"]
        keys = (self._numbers[name] for name in ("envs", "episodes", "steps"))
        chance = uniform("robot.lost.now", 1, self._seed, *keys)
        lost = chance < self._drawn["robot.lost"].amount
        # The servos hold the command before a lost one.
        before = sent[(steps - 1) % len(sent), rows]
        sent[steps % len(sent), rows] = torch.where(lost, before, control)
        late = self._drawn["robot.late"].amount[:, 0].long()
        return sent[(steps - late) % len(sent), rows]

    # What the cameras show.

    def optics(self, fields: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        """The fields of all environments as they are drawn; see ``engines.contract.Optics``."""
        n, at, drawn = len(self._levels), self._cameras, dict(fields)
        if self._does("camera."):
            places = fields["cam_xpos"].reshape(n, -1, 3).clone()
            turns = fields["cam_xmat"].reshape(n, -1, 3, 3).clone()
            zoom = torch.ones(turns.shape[:2], dtype=torch.float64, device=self._device)
            time = (self._numbers["steps"].double() / self._max_steps).clamp(max=1.0)
            place, turn = optics.cameras(
                places[:, at], turns[:, at], self._moved, time, self._mounted
            )
            places[:, at], turns[:, at] = place.to(places), turn.to(turns)
            zoom[:, at] = self._moved.zoom
            drawn |= {"cam_xpos": places, "cam_xmat": turns, "cam_zoom": zoom}
        if self._does("scene."):
            places = fields["geom_xpos"].reshape(n, -1, 3).clone()
            places[:, self._strange] = self._lying.to(places)
            shining = fields["light_xdir"].reshape(n, -1, 3, 1).double()
            shining = (self._moved.lamp[:, None] @ shining)[..., 0]
            drawn |= {"geom_xpos": places, "light_xdir": shining}
        if self._does(*(key for key in RASTERISED if key.startswith("scene."))):
            drawn |= optics.looks(self._drawn, self._things)
        return drawn

    def spoiler(self, ids: Tensor | None) -> Spoiler | None:
        """A function that adds flaws to frames of environments ``ids`` (all by default)."""
        if self._sensors is None or not self._does(*_SENSORS):
            return None
        rows = self._rows(ids)
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
        rows, last = self._rows(ids), self._pictures
        steps = self._numbers["steps"][rows]
        late, *fails = (Drawn(*(one[rows] for one in self._drawn[key])) for key in _DELIVERY)
        old = torch.minimum(late.amount[..., 0].long(), steps[:, None])
        frozen, black = (failing(one, steps, len(self._views), self._max_steps) for one in fails)
        arrivals = {}
        for name, image in images.items():
            at = self._views.index(views[name])
            if name not in self._kept:
                shape = (last + 1, len(self._levels), *image.shape[1:])
                self._kept[name] = torch.zeros(shape, dtype=torch.uint8, device=self._device)
            # The last pictures by step, and after them what arrived last.
            kept = self._kept[name]
            kept[steps % last, rows] = image
            seen = kept[(steps - old[:, at]) % last, rows]
            seen = torch.where(frozen[:, at, None, None, None], kept[last, rows], seen)
            seen = seen.masked_fill(black[:, at, None, None, None], 0)
            kept[last, rows] = seen
            arrivals[name] = seen
        return arrivals

    def snapshot(self) -> dict[str, Any]:
        """Everything that decides the future."""
        sent = {} if self._sent is None else {"sent": self._sent.clone()}
        return {
            "seed": torch.tensor(self._seed),
            **{name: one.clone() for name, one in self._numbers.items()},
            "levels": self._levels.clone(),
            **sent,
            "kept": {name: one.clone() for name, one in self._kept.items()},
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a ``snapshot`` of a disturbance with the same amounts."""
        self._seed = int(snapshot["seed"])
        for name, number in self._numbers.items():
            number.copy_(snapshot[name])
        self._levels.copy_(snapshot["levels"])
        self._sent = snapshot["sent"].to(self._device, copy=True) if "sent" in snapshot else None
        kept = snapshot["kept"].items()
        self._kept = {name: one.to(self._device, copy=True) for name, one in kept}
        keys = (self._numbers[name].cpu() for name in ("envs", "episodes"))
        self._draw(self._rows(None), *keys)


def failing(drawn: Drawn, steps: Tensor, views: int, max_steps: int) -> Tensor:
    """Which view fails after ``steps`` ``(k,)``, as ``(k, views)`` bool: at most one of them.

    ``drawn``: for how many steps; then when it begins, and which view.
    """
    # It begins to fail in the first quarter of an episode's time.
    begins = 1 + torch.floor(drawn.free[:, 0] * 0.25 * max_steps)
    now = (steps >= begins) & (steps < begins + drawn.amount[:, 0])
    which = torch.floor(drawn.free[:, 1] * views)
    return now[:, None] & (which[:, None] == torch.arange(views, device=steps.device))
