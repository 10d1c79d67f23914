"""Cameras by drawing triangles."""

# Warp's structs are no classes to pyright.
# pyright: reportGeneralTypeIssues=false
from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp

from needlehoop.engines.contract import OPTICS, ZOOM, Channels, Frame
from needlehoop.engines.quiet_start import start_warp
from needlehoop.engines.rasteriser.buffers import (
    PATTERN,
    FrameBuffers,
    Lens,
    Poses,
    ScratchBuffers,
)
from needlehoop.engines.rasteriser.kernel import draw
from needlehoop.engines.rasteriser.solids import Solids, pack

_MOST = 2**31 - 1
"""Pixels that the kernel can count."""


class Rasteriser:
    """Renders ``n`` environments, split over threads; any number of them gives the same bits.

    Curved geoms are polygons within 0.1 mm. Colours have no shadows and no highlights, as in
    ``Tracer`` with ``quality=1``.

    Args:
        model: the scene.
        num_envs: environments.
        views: channels to draw by view, e.g. ``{"front": Channels(True, True, False)}``.
        size: width and height of the images, px.
        threads: how many draw side by side.

    Raises:
        ValueError: ``size`` below 1 or too large, or a scene that can't be drawn; see
            ``solids.pack``.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: int,
        threads: int,
    ):
        if size < 1:
            raise ValueError(f"image_size: {size} must be at least 1")
        if len(views) * num_envs * size**2 > _MOST:
            raise ValueError(
                f"image_size: {len(views)} views of {num_envs} environments at {size} px have more"
                f" than {_MOST} pixels; choose fewer"
            )
        start_warp()
        self.views = dict(views)
        self._size, self._solids = size, pack(model)
        counts = [iter(range(len(views))) for _ in range(3)]
        self._images = {
            view: [next(at) if wanted else -1 for at, wanted in zip(counts, channels, strict=True)]
            for view, channels in views.items()
        }
        self._lenses = _lenses(model, self._images)
        self._buffers = _frame_buffers(self.views, num_envs, size)
        self._poses, self._fields = _poses(model, num_envs)
        self._tangents = np.tan(np.deg2rad(model.cam_fovy) / 2)
        self._fields["cam_tangent"][:] = self._tangents
        self._poses.pattern = wp.array(_pattern(), dtype=float, device="cpu")
        self._scratch = [
            _scratch_buffers(self._solids, size) for _ in range(min(threads, num_envs))
        ]
        # The first launch compiles: before any other thread launches.
        self._draw(self._scratch[0], 0, 0)
        self._pool = ThreadPoolExecutor(len(self._scratch)) if len(self._scratch) > 1 else None
        self._kinds = (
            wp.to_torch(self._buffers.colour).view(torch.uint8).view(-1, num_envs, size, size, 4),
            wp.to_torch(self._buffers.depth).view(-1, num_envs, size, size),
            wp.to_torch(self._buffers.geom).view(-1, num_envs, size, size),
        )

    def render(
        self, fields: Mapping[str, np.ndarray], ids: np.ndarray | None = None
    ) -> dict[str, Frame]:
        """A frame per view.

        Args:
            fields: MjData ``FIELDS``, perhaps ``OPTICS``, with a leading dimension of ``n``.
            ids: environments to render ``(k,)``; all by default.
        """
        count = self._buffers.count if ids is None else len(ids)
        chosen = slice(None) if ids is None else ids
        for name, target in self._fields.items():
            if name in fields:
                target[:count] = fields[name][chosen].reshape(count, *target.shape[1:])
            elif name in OPTICS:
                target[:count] = OPTICS[name]
        zoom = fields[ZOOM][chosen] if ZOOM in fields else 1.0
        self._fields["cam_tangent"][:count] = self._tangents / zoom
        edges = np.linspace(0, count, len(self._scratch) + 1).astype(int).tolist()
        slices = [
            (scratch, *ends) for scratch, ends in zip(self._scratch, pairwise(edges), strict=True)
        ]
        if self._pool is None:
            self._draw(*slices[0])
        else:
            list(self._pool.map(lambda part: self._draw(*part), slices))
        return {
            view: Frame(
                *(
                    kind[at][:count] if at >= 0 else None
                    for kind, at in zip(self._kinds, images, strict=True)
                )
            )
            for view, images in self._images.items()
        }

    def _draw(self, scratch: ScratchBuffers, first: int, last: int) -> None:
        scene = (self._solids, self._lenses, self._poses)
        inputs = [*scene, scratch, self._buffers, self._size, first, last]
        wp.launch(draw, dim=1, inputs=inputs, device="cpu")


def _pattern() -> np.ndarray:
    """Smooth noise in [-1, 1] without a seam; always the same."""
    side = int(PATTERN)
    noise = np.random.default_rng(0).standard_normal((side, side))
    # Waves of four cells and longer.
    waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * (waves < 0.25)).real
    return (smooth / np.abs(smooth).max()).astype(np.float32)


def _lenses(model: mujoco.MjModel, images: Mapping[str, list[int]]) -> wp.array:
    """A lens for each view, with the images that it makes."""
    rows = []
    for view, indices in images.items():
        camera = model.camera(view).id
        if model.cam_sensorsize[camera].any() or model.cam_projection[camera] != 0:
            raise ValueError(f"camera {view}: only a perspective given by fovy can be drawn")
        rows.append((camera, *indices))
    dtype: Any = Lens.numpy_dtype()
    return wp.array(np.array(rows, dtype), dtype=Lens, device="cpu")


def _frame_buffers(views: Mapping[str, Channels], num_envs: int, size: int) -> FrameBuffers:
    frames = FrameBuffers()
    colours, depths, geoms = (sum(asked) for asked in zip(*views.values(), strict=True))
    pixels = num_envs * size * size
    frames.colour = wp.zeros(colours * pixels, dtype=wp.uint32, device="cpu")
    frames.depth = wp.zeros(depths * pixels, dtype=float, device="cpu")
    frames.geom = wp.zeros(geoms * pixels, dtype=int, device="cpu")
    frames.count = num_envs
    return frames


def _poses(model: mujoco.MjModel, num_envs: int) -> tuple[Poses, dict[str, np.ndarray]]:
    """Poses for the kernel, and the same memory as arrays ``(n, objects, ...)`` by field."""
    poses, fields = Poses(), {}
    counts = {"geom": model.ngeom, "cam": model.ncam, "light": model.nlight, "lamp": 1, "table": 1}
    for name, variable in Poses.vars.items():
        # All but the pattern, which is of no object.
        if (kind := name.partition("_")[0]) in counts:
            usual, dtype = OPTICS.get(name, 0.0), variable.type.dtype
            array = wp.full((num_envs, counts[kind]), usual, dtype=dtype, device="cpu")
            setattr(poses, name, array)
            fields[name] = array.numpy()
    return poses, fields


def _scratch_buffers(solids: Solids, size: int) -> ScratchBuffers:
    scratch = ScratchBuffers()
    vertices, pixels = solids.vertices.shape[0], size * size
    scratch.corners = wp.zeros(vertices, dtype=wp.vec3, device="cpu")
    scratch.points = wp.zeros(vertices, dtype=wp.vec2, device="cpu")
    scratch.turns = wp.zeros(solids.solids.shape[0], dtype=wp.mat33, device="cpu")
    scratch.lamps = wp.zeros(solids.lamps.shape[0], dtype=wp.vec3, device="cpu")
    scratch.nearness = wp.zeros(pixels, dtype=float, device="cpu")
    scratch.face = wp.zeros(pixels, dtype=int, device="cpu")
    return scratch
