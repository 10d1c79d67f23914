"""Engines by their kind."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from needlehoop.engines.contract import Channels, Engine, EngineConfig
from needlehoop.tasks.contract import Robot


def build_engine(
    model: mujoco.MjModel,
    robot: Robot,
    num_envs: int,
    substeps: int,
    views: Mapping[str, Channels],
    size: int,
    quality: int,
    config: EngineConfig,
) -> Engine:
    """An engine of the kind that ``config`` names.

    Args:
        model: the compiled scene.
        robot: in it.
        num_envs: copies of it.
        substeps: physics steps per control step.
        views: channels to trace by view; empty for no cameras.
        size: image width and height, px.
        quality: of the images, see ``Tracer``.
        config: kind and threads.

    Raises:
        ValueError: fewer than one environment.
    """
    if config.kind == "dm_control":
        # Imported where it is asked for: dm_control takes a while.
        from needlehoop.engines.dm_control import DmControlEngine as Kind
    else:
        from needlehoop.engines.cpu import CpuEngine as Kind
    return Kind(model, robot, num_envs, substeps, views, size, quality, config)
