"""Cameras by drawing triangles."""

# Warp's structs are no classes to pyright.
# pyright: reportGeneralTypeIssues=false
from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np
import torch
import warp as wp
from torch import Tensor

from needlehoop.engines import warp_device
from needlehoop.engines.contract import OPTICS, Channels, Frame
from needlehoop.engines.rasteriser import kernel, parallel
from needlehoop.engines.rasteriser.buffers import PATTERN, FrameBuffers, Lens, Poses, ScratchBuffers
from needlehoop.engines.rasteriser.solids import pack
from needlehoop.engines.warp_device import start_warp
from needlehoop.scene.image_size import ImageSize, sides


class Rasteriser(ABC):
    """Renders ``n`` environments on a device; a subclass says how it is drawn.

    Curved geoms are polygons within 0.1 mm. Colours have no shadows and no highlights, as in
    ``Tracer`` with ``quality=1``. What can be drawn: see ``solids.pack``.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: ImageSize,
        device: torch.device,
    ):
        start_warp()
        self._warp = wp.device_from_torch(device)
        self._solids = pack(model, self._warp)
        width, height = sides(size)
        self._size = wp.vec2i(width, height)
        counts = [iter(range(len(views))) for _ in range(3)]
        self._images = {
            view: [next(at) if needed else -1 for at, needed in zip(counts, channels, strict=True)]
            for view, channels in views.items()
        }
        rows = [(model.camera(view).id, *images) for view, images in self._images.items()]
        dtype: Any = Lens.numpy_dtype()
        self._lenses = wp.array(np.array(rows, dtype), dtype=Lens, device=self._warp)
        pixels = width * height
        sizes = [num_envs * pixels * sum(needs) for needs in zip(*views.values(), strict=True)]
        lengths = dict(zip(("colour", "depth", "geom"), sizes, strict=True))
        self._buffers = self._zeros(FrameBuffers, **lengths)
        self._buffers.count = num_envs
        objects = {"geom": model.ngeom, "cam": model.ncam, "light": model.nlight}
        objects |= {"lamp": 1, "table": 1}
        kinds = {name: name.partition("_")[0] for name in Poses.vars if name != "pattern"}
        shapes = {name: (num_envs, objects[kind]) for name, kind in kinds.items()}
        self._poses = self._zeros(Poses, **shapes)
        self._poses.pattern = wp.array(_pattern(), dtype=float, device=self._warp)
        self._fields = {name: wp.to_torch(getattr(self._poses, name)) for name in shapes}
        tangents = np.tan(np.deg2rad(model.cam_fovy) / 2)
        self._tangents = torch.from_numpy(tangents).to(device)
        self._kinds = (
            wp.to_torch(self._buffers.colour)
            .view(torch.uint8)
            .view(-1, num_envs, height, width, 4),
            wp.to_torch(self._buffers.depth).view(-1, num_envs, height, width),
            wp.to_torch(self._buffers.geom).view(-1, num_envs, height, width),
        )

    def render(self, fields: Mapping[str, Tensor], ids: Tensor | None = None) -> dict[str, Frame]:
        """A frame per view of environments ``ids`` ``(k,)``, or of all.

        ``fields``: ``FIELDS`` of MjData ``(n, ...)``, perhaps with ``OPTICS``.
        """
        count = self._buffers.count if ids is None else len(ids)
        chosen = slice(None) if ids is None else ids
        for name, target in self._fields.items():
            if name in fields:
                target[:count] = fields[name][chosen].reshape(count, *target.shape[1:])
            elif name in OPTICS:
                target[:count] = OPTICS[name]
        zoom = fields["cam_zoom"][chosen] if "cam_zoom" in fields else OPTICS["cam_zoom"]
        self._fields["cam_tangent"][:count] = self._tangents / zoom
        self._draw(count)
        return {
            view: Frame(
                *(
                    kind[at][:count] if at >= 0 else None
                    for kind, at in zip(self._kinds, images, strict=True)
                )
            )
            for view, images in self._images.items()
        }

    @abstractmethod
    def _draw(self, count: int) -> None:
        """Draw the first ``count`` environments."""

    def _zeros(self, struct: Any, **shapes: int | tuple[int, int]) -> Any:
        """One of Warp's structs, with arrays of these shapes."""
        made = struct()
        for name, shape in shapes.items():
            dtype = struct.vars[name].type.dtype
            setattr(made, name, wp.zeros(shape, dtype=dtype, device=self._warp))
        return made


class CpuRasteriser(Rasteriser):
    """Draws image after image, split over threads; any number of threads gives the same bits."""

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: ImageSize,
        threads: int,
    ):
        super().__init__(model, num_envs, views, size, torch.device("cpu"))
        vertices, pixels = self._solids.vertices.shape[0], math.prod(sides(size))
        lengths = {"corners": vertices, "points": vertices, "nearness": pixels, "face": pixels}
        lengths["turns"] = self._solids.solids.shape[0]
        lengths["lamps"] = self._solids.lamps.shape[0]
        shares = min(threads, num_envs)
        self._scratch = [self._zeros(ScratchBuffers, **lengths) for _ in range(shares)]
        # The first launch compiles: before any other thread launches.
        self._draw_some(self._scratch[0], 0, 0)
        self._map: Any = ThreadPoolExecutor(shares).map if shares > 1 else map

    def _draw(self, count: int) -> None:
        edges = np.linspace(0, count, len(self._scratch) + 1).astype(int).tolist()
        list(self._map(self._draw_some, self._scratch, edges[:-1], edges[1:]))

    def _draw_some(self, scratch: Any, first: int, last: int) -> None:
        scene = (self._solids, self._lenses, self._poses)
        inputs = [*scene, scratch, self._buffers, self._size, first, last]
        wp.launch(kernel.draw, dim=1, inputs=inputs, device="cpu")


class ParallelRasteriser(Rasteriser):
    """Draws all images at once, a thread for each face and each pixel: for GPUs.

    Colours and ids are the ``CpuRasteriser``'s. An image takes 180 to 300 kB while it is drawn, so
    no more than ``_AT_ONCE`` are.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: ImageSize,
        device: torch.device,
    ):
        super().__init__(model, num_envs, views, size, device)
        self._device, solids = device, self._solids
        self._at_once = max(1, min(num_envs, _AT_ONCE // len(views)))
        images = self._at_once * len(views)
        lengths = {"corners": solids.vertices.shape[0], "points": solids.vertices.shape[0]}
        lengths |= {"turns": solids.solids.shape[0], "seen": solids.solids.shape[0]}
        lengths |= {"slopes": solids.faces.shape[0], "lamps": solids.lamps.shape[0]}
        self._pixels = lengths["keys"] = math.prod(sides(size))
        shapes = {name: (images, length) for name, length in lengths.items()}
        self._scratch = self._zeros(parallel.Images, **shapes)
        # Compiles, because nothing may compile while a CUDA graph is captured.
        self._draw(0)

    def _draw(self, count: int) -> None:
        size, views, faces = self._size, self._lenses.shape[0], self._solids.faces.shape[0]
        with warp_device.on(self._device):
            for first in range(0, max(count, 1), self._at_once):
                images = max(0, min(self._at_once, count - first)) * views
                args = [self._solids, self._lenses, self._poses, self._scratch, size, first]
                solids = self._solids.solids.shape[0]
                wp.launch(parallel.project, dim=(images, solids), inputs=args)
                strips = (images, faces, parallel.STRIPS)
                wp.launch(parallel.cover, dim=strips, inputs=args)
                wp.launch(parallel.shade, dim=(images, self._pixels), inputs=[*args, self._buffers])


_AT_ONCE = 4096
"""Images."""


def _pattern() -> np.ndarray:
    """Smooth noise in [-1, 1] without a seam; always the same."""
    side = int(PATTERN)
    noise = np.random.default_rng(0).standard_normal((side, side))
    # Waves of four cells and longer.
    waves = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * (waves < 0.25)).real
    return (smooth / np.abs(smooth).max()).astype(np.float32)
