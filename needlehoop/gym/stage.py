"""What Env and VectorEnv share: simulation and observer, with numpy on the outside."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import Error, InvalidAction
from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Pixels, check_names, shown
from needlehoop.envs.build import build
from needlehoop.envs.observer import Observer, vectors
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Moment
from needlehoop.pictures.stills import Photographer

CHANNELS = ("last", "first")
"""Where the channels of an image stand: ``(h, w, c)`` or ``(c, h, w)``."""


class Stage:
    """``num_envs`` environments that take and give numpy arrays.

    Args:
        settings: what to build; the seed is given to ``reset``.
        channels: one of ``CHANNELS``.
        mode: ``render_mode``, one of ``modes`` or ``None``.
        modes: that there are.
        size: of the pictures of ``rgb_array``, px.

    Raises:
        ValueError: settings that do not go together, or nothing to observe; names the key.
        Error: this process was forked from one whose environments had been used.
    """

    _used_in: int | None = None
    """The process in which an environment was used first: its threads are not in a fork."""

    def __init__(
        self,
        settings: Settings,
        channels: str,
        mode: str | None,
        modes: tuple[str, ...],
        size: int,
    ):
        if Stage._used_in not in (None, os.getpid()):
            raise Error(
                "environments were used before this process was forked, and would hang or crash"
                ' here; use AsyncVectorEnv(..., context="spawn"), or make_vec, which needs no'
                " processes"
            )
        check_names("render_mode", [mode] if mode is not None else [], modes)
        strict.structure(size, Pixels, "render_size")
        check_names("channels", [channels], CHANNELS)
        if not (settings.cams or vectors(settings.definition, settings.obs)):
            raise ValueError(
                "cams: nothing is observed; name cameras, such as dep_front,seg_side, or choose"
                " obs=signals or obs.proprio=true"
            )
        self.simulation, imager = build(settings)
        self._observer = Observer(settings, self.simulation, imager)
        model = self.simulation.engine.model
        self._photographer = Photographer(model, size) if mode == "rgb_array" else None
        self._last = channels == "last"
        self.observation_space = self._space(settings)
        self.action_space = spaces.Box(-1.0, 1.0, (settings.episode.action_size,), np.float32)

    def _space(self, settings: Settings) -> spaces.Dict:
        size = settings.image_size
        found: dict[str, spaces.Space] = {}
        for name, count in settings.image_channels.items():
            shape = (size, size, count) if self._last else (count, size, size)
            found[name] = spaces.Box(0, 255, shape, np.uint8)
        for name, length in vectors(settings.definition, settings.obs).items():
            low, high = (0.0, 1.0) if name == "told" else (-np.inf, np.inf)
            found[name] = spaces.Box(low, high, (length,), np.float32)
        return spaces.Dict(found)

    def reset(self, seed: int | None = None, mask: np.ndarray | None = None) -> Moment:
        """Begin the next episode where ``mask`` ``(n,)`` is true (everywhere by default).

        With a seed, everywhere that seed's first.
        """
        Stage._used_in = os.getpid()
        if seed is not None:
            self.simulation.reseed(seed)
        if self.simulation.state is None:
            self._observer.forget()
        return self.simulation.reset(None if mask is None else torch.from_numpy(mask))

    def step(self, action: np.ndarray) -> Moment:
        """One control step of every environment under ``action`` ``(n, action_size)``."""
        # A copy: torch would warn of arrays that it may not write to.
        return self.simulation.step(torch.from_numpy(np.array(action, dtype=np.float64)))

    def picture(self, env: int) -> np.ndarray | None:
        """The scene of an environment ``(size, size, 3)`` uint8, in the mode ``rgb_array``."""
        if self._photographer is None:
            return None
        return self._photographer(self.simulation.engine.data(env))

    def numbers(self, action: Any, count: int | None = None) -> np.ndarray:
        """An action, or ``count`` of them, as an array of real numbers.

        Raises:
            InvalidAction: something else, or another shape.
        """
        found = np.asarray(action)
        size = self.action_space.shape
        shape = size if count is None else (count, *size)
        if found.dtype.kind not in "iuf" or found.shape != shape:
            raise InvalidAction(
                f"action: {found.dtype} {found.shape}; expected real numbers {shape} in [-1, 1]"
            )
        return found

    def look(self, moment: Moment, ids: Tensor | None = None) -> dict[str, np.ndarray]:
        """What all ``n`` environments observe, as new arrays by name.

        Args:
            moment: the present one.
            ids: environments whose images are new; all by default.
        """
        seen = self._observer(moment.signals, ids)
        pixels: Any = seen.pop("pixels", {})
        turned = {
            name: image.permute(0, 2, 3, 1) if self._last else image
            for name, image in pixels.items()
        }
        # Copies: the observer keeps its images, and callers may write to theirs.
        vectors: dict[str, Any] = seen
        return {name: _array(value) for name, value in (turned | vectors).items()}


def check_options(options: Any, valid: Iterable[str] = ()) -> None:
    """Raises Gymnasium's ``Error`` for options of ``reset`` that there are not."""
    if options is not None and not isinstance(options, Mapping):
        raise Error(f"options: {shown(options)} has no keys")
    for key in options or ():
        if key not in valid:
            known = f"choose from {', '.join(valid)}" if valid else "reset takes none"
            raise Error(f"options: {shown(key)} is unknown; {known}")


def info(moment: Moment) -> dict[str, Any]:
    """What is known beside the observation, ``(n,)`` each: facts and terms by name, verdicts."""
    facts = {name: _array(fact) for name, fact in moment.facts.items()}
    return {
        "facts": facts,
        "terms": {name: _array(term) for name, term in moment.terms.items()},
        **{name: facts[name].copy() for name in ("success", "cheat") if name in facts},
        "potential": _array(moment.potential),
        "steps": _array(moment.steps),
    }


def row(values: dict[str, Any], env: int) -> dict[str, Any]:
    """One environment's part of ``info``, as plain values."""
    return {
        name: row(value, env) if isinstance(value, dict) else value[env].item()
        for name, value in values.items()
    }


def masked(values: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Batched ``info`` as Gymnasium's vector environments give it.

    Each name comes with ``_<name>``, which says whose values are there; the others' are zero.
    """
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            found[name] = masked(value, mask)
        else:
            found[name] = np.where(mask, value, np.zeros_like(value))
        found[f"_{name}"] = mask.copy()
    return found


def _array(tensor: Tensor) -> np.ndarray:
    """A copy, contiguous."""
    return np.array(tensor.numpy(), order="C")
