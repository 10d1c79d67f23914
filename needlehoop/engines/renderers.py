"""Which renderer makes the images."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from needlehoop.engines.contract import Channels, Renderer
from needlehoop.engines.rasteriser.renderer import Rasteriser


def make_renderer(
    kind: str,
    model: mujoco.MjModel,
    num_envs: int,
    views: Mapping[str, Channels],
    size: int,
    threads: int,
    quality: int,
) -> Renderer:
    """A renderer of ``num_envs`` environments.

    Args:
        kind: of ``contract.RENDERERS``; pictures for people (``quality`` > 1) are always traced.
        model: the scene.
        num_envs: environments.
        views: channels to render by view.
        size: image width and height, px.
        threads: how many render side by side.
        quality: see ``Tracer``.

    Raises:
        ValueError: a size or scene that can't be rendered.
    """
    if kind == "rasteriser" and quality == 1:
        return Rasteriser(model, num_envs, views, size, threads)
    # Imported where it is used: mujoco_warp takes two seconds.
    from needlehoop.engines.tracer import Tracer

    return Tracer(model, num_envs, views, size, threads, quality)
