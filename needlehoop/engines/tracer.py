"""Cameras by mujoco_warp's ray tracer: no OpenGL, the same code on CPU and GPU."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

from needlehoop.engines.contract import FIELDS, Channels, Frame
from needlehoop.engines.quiet_start import start_warp

_GROUPS = [0, 1]
"""Geom groups that are drawn; collision shapes are in group 3."""

_FEW = 4
"""Worlds of the context that serves resets."""


class Tracer:
    """Renders ``n`` environments, split over threads.

    Args:
        model: the scene.
        num_envs: environments.
        views: channels to trace by view, e.g. ``{"front": Channels(True, True, False)}``.
        size: width and height of the images, px.
        threads: render contexts, each with a thread of its own.
        quality: 1 traces one ray a pixel without shadows (what agents see); k > 1 traces
            k x k rays with shadows (pictures for people).

    Raises:
        ValueError: ``size`` or ``quality`` below 1.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: int,
        threads: int,
        quality: int = 1,
    ):
        for key, value in (("image_size", size), ("quality", quality)):
            if value < 1:
                raise ValueError(f"{key}: {value} must be at least 1")
        start_warp()
        self.views = dict(views)
        self._num_envs = num_envs
        edges = np.linspace(0, num_envs, min(threads, num_envs) + 1).astype(int).tolist()
        self._parts = [
            _Part(model, slice(a, b), self.views, size, quality) for a, b in pairwise(edges)
        ]
        self._few = _Part(model, slice(0, min(num_envs, _FEW)), self.views, size, quality)
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None

    def render(
        self, fields: Mapping[str, np.ndarray], ids: np.ndarray | None = None
    ) -> dict[str, Frame]:
        """A frame per view.

        Args:
            fields: MjData ``FIELDS`` with a leading dimension of ``n``.
            ids: environments to render ``(k,)``; all by default.
        """
        if ids is not None and 2 * len(ids) < self._num_envs:
            return self._render_few(fields, ids)
        if self._pool is None:
            parts = [self._parts[0].render(fields)]
        else:
            parts = list(self._pool.map(lambda part: part.render(fields), self._parts))
        frames = _concatenate(parts)
        return frames if ids is None else _rows(frames, torch.from_numpy(ids))

    def _render_few(self, fields: Mapping[str, np.ndarray], ids: np.ndarray) -> dict[str, Frame]:
        """A few environments, a handful at a time in a small context of its own.

        Episodes end at different steps, so nearly every step resets somebody: tracing
        everybody again would double the cost of a step.
        """
        width = self._few.worlds
        rounds = []
        for at in range(0, len(ids), width):
            chosen = ids[at : at + width]
            padded = np.concatenate((chosen, np.repeat(chosen[-1:], width - len(chosen))))
            frames = self._few.render({name: fields[name][padded] for name in FIELDS})
            rounds.append(_rows(frames, torch.arange(len(chosen))))
        return _concatenate(rounds)


class _Part:
    """One render context over a slice of the environments."""

    def __init__(
        self,
        model: mujoco.MjModel,
        envs: slice,
        views: Mapping[str, Channels],
        size: int,
        quality: int,
    ):
        self._envs, self._size, self._views = envs, size, views
        self.worlds = worlds = envs.stop - envs.start
        self._model = mjw.put_model(model)
        self._data = mjw.make_data(model, nworld=worlds, nconmax=1, njmax=1)
        self._context = mjw.create_render_context(
            model,
            nworld=worlds,
            cam_res=(size, size),
            cam_active=list(views),
            render_rgb=[channels.colour for channels in views.values()],
            render_depth=[channels.depth for channels in views.values()],
            render_seg=[channels.geom for channels in views.values()],
            enabled_geom_groups=_GROUPS,
            use_textures=False,
            # No camera is ever inside a geom. Together with highlights left out of what
            # agents see this saves a quarter of the time.
            enable_backface_culling=False,
            enable_specular=quality > 1,
            use_shadows=quality > 1,
            samples_per_pixel=quality if any(c.colour for c in views.values()) else 1,
        )
        # A context whose first launch races another's stays broken (it drops objects),
        # so each one is used once here, before any thread has it.
        with _fast_compilation():
            self._launch()

    def render(self, fields: Mapping[str, np.ndarray]) -> dict[str, Frame]:
        for name in FIELDS:
            target = getattr(self._data, name).numpy()
            target[...] = fields[name][self._envs].reshape(target.shape)
        self._launch()
        context = self._context
        colour = wp.to_torch(context.rgb_data).view(torch.uint8)
        depth, geom = wp.to_torch(context.depth_data), wp.to_torch(context.seg_data)
        frames, at = {}, [0, 0, 0]
        pixels = self._size**2
        for view, channels in self._views.items():
            picked = []
            for i, (wanted, buffer) in enumerate(zip(channels, (colour, depth, geom), strict=True)):
                picked.append(self._cut(buffer, i, at[i], pixels) if wanted else None)
                at[i] += pixels * wanted
            frames[view] = Frame(*picked)
        return frames

    def _cut(self, buffer: torch.Tensor, channel: int, start: int, pixels: int) -> torch.Tensor:
        square = (buffer.shape[0], self._size, self._size)
        if channel == 0:
            return buffer[:, 4 * start : 4 * (start + pixels)].reshape(*square, 4)
        picked = buffer[:, start : start + pixels]
        return picked.reshape(square) if channel == 1 else picked[..., 0].reshape(square)

    def _launch(self) -> None:
        mjw.refit_bvh(self._model, self._data, self._context)
        mjw.render(self._model, self._data, self._context)


@contextmanager
def _fast_compilation() -> Iterator[None]:
    """Let the compiler reorder floating-point sums in kernels compiled in this block.

    A fifth faster; it moves a few pixels in a million, at edges. mujoco_warp asks for fast
    mathematics itself, but Warp passes that on to CUDA only. Warp's own headers name infinity and
    NaN, of which the compiler would then warn over a page at the first run.
    """
    before = wp.config.cpu_compiler_flags
    flags = before or "-march=native"
    wp.config.cpu_compiler_flags = f"{flags} -ffast-math -Wno-nan-infinity-disabled"
    try:
        yield
    finally:
        wp.config.cpu_compiler_flags = before


def _concatenate(parts: list[dict[str, Frame]]) -> dict[str, Frame]:
    """Frames of consecutive slices as one."""
    if len(parts) == 1:
        return parts[0]
    return {
        view: Frame(
            *(
                None if buffers[0] is None else torch.cat(buffers)
                for buffers in zip(*(part[view] for part in parts), strict=True)
            )
        )
        for view in parts[0]
    }


def _rows(frames: dict[str, Frame], ids: torch.Tensor) -> dict[str, Frame]:
    """A copy of the chosen environments' frames."""
    return {
        view: Frame(*(None if buffer is None else buffer[ids] for buffer in frame))
        for view, frame in frames.items()
    }
