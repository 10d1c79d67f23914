"""Cameras by mujoco_warp's ray tracer: no OpenGL, the same code on CPU and GPU."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import mujoco_warp as mjw
import torch
import warp as wp
from torch import Tensor

from needlehoop.engines.contract import FIELDS, Channels, Frame
from needlehoop.engines.warp_device import start_warp
from needlehoop.scene.image_size import ImageSize, sides


class Tracer:
    """Renders environments, one after the other.

    ``quality``: 1 traces one ray a pixel without shadows (what agents see); k > 1 traces
    k x k rays with shadows (pictures for people).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        views: Mapping[str, Channels],
        size: ImageSize,
        quality: int = 1,
    ):
        start_warp()
        self.views, self._sides = dict(views), sides(size)
        self._model = mjw.put_model(model)
        self._data = mjw.make_data(model, nworld=num_envs, nconmax=1, njmax=1)
        self._context = mjw.create_render_context(
            model,
            nworld=num_envs,
            cam_res=self._sides,
            cam_active=list(views),
            render_rgb=[channels.colour for channels in views.values()],
            render_depth=[channels.depth for channels in views.values()],
            render_seg=[channels.geom for channels in views.values()],
            # Collision shapes are in group 3.
            enabled_geom_groups=[0, 1],
            use_textures=False,
            # No camera is ever inside a geom. Together with highlights left out of what
            # agents see this saves a quarter of the time.
            enable_backface_culling=False,
            enable_specular=quality > 1,
            use_shadows=quality > 1,
            samples_per_pixel=quality if any(c.colour for c in views.values()) else 1,
        )
        # A context whose first launch races another's drops objects for good. So each one is used
        # once here, before any thread has it. This compiles the kernels: with -ffast-math they are
        # a fifth faster, and a few pixels in a million at edges differ. (mujoco_warp asks for it
        # too, but Warp passes that on to CUDA only.)
        before = wp.config.cpu_compiler_flags
        flags = f"{before or '-march=native'} -ffast-math -Wno-nan-infinity-disabled"
        wp.config.cpu_compiler_flags = flags
        try:
            self._launch()
        finally:
            wp.config.cpu_compiler_flags = before

    def render(self, fields: Mapping[str, Tensor], ids: Tensor | None = None) -> dict[str, Frame]:
        """A frame per view of environments ``ids`` ``(k,)``, or of all; all are traced anyway.

        ``fields``: ``FIELDS`` of MjData ``(n, ...)``.
        """
        for name in FIELDS:
            target = getattr(self._data, name).numpy()
            target[...] = fields[name].numpy().reshape(target.shape)
        self._launch()
        context = self._context
        colour = wp.to_torch(context.rgb_data).view(torch.uint8)
        kinds = (
            colour.unflatten(1, (-1, 4)),
            wp.to_torch(context.depth_data),
            wp.to_torch(context.seg_data)[..., 0],
        )
        width, height = self._sides
        frames, at, pixels = {}, [0, 0, 0], width * height
        chosen = slice(None) if ids is None else ids
        for view, channels in self.views.items():
            picked = []
            for i, (needed, kind) in enumerate(zip(channels, kinds, strict=True)):
                if not needed:
                    picked.append(None)
                    continue
                channel = kind[chosen, at[i] : at[i] + pixels].unflatten(1, (height, width))
                at[i] += pixels
                # The sensors take them by their addresses.
                picked.append(channel.contiguous())
            frames[view] = Frame(*picked)
        return frames

    def _launch(self) -> None:
        mjw.refit_bvh(self._model, self._data, self._context)
        mjw.render(self._model, self._data, self._context)
