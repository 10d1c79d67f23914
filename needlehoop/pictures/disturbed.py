"""One sheet of what a camera shows under each axis of disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice

import torch
from PIL import Image

from needlehoop.disturbances.axes import AXES, amount_at, disturb_of
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.rollout import rollout
from needlehoop.envs.settings import Settings
from needlehoop.pictures.stills import scaled, sheet

_STEPS = 10
"""Steps of the expert before the picture is taken: late and frozen pictures show then."""

_SHOWN = (0, 1, 3, 5)
"""Severities; 0: undisturbed."""


def disturbed_sheet(
    settings: Settings, levels: Mapping[str, Mapping[str, Sequence[float]]], tile: int
) -> Image.Image:
    """A row for each axis that can be seen; undisturbed, then severities 1, 3 and 5 by camera.

    Each tile is what one episode drew: a uniform share of the severity's amount. The episode is
    the same everywhere.

    Args:
        settings: with the cameras to show; its own disturbances are ignored.
        levels: amounts at severities 1 to 5, as in ``conf/levels``.
        tile: side of a tile, px.

    Raises:
        ValueError: no camera.
    """
    if not settings.cams:
        raise ValueError("cams: choose the cameras to show, such as cams=rgb_front,dep_front")
    axes = [key for key in AXES if not key.startswith("robot.")]
    cases = [(key, severity) for key in axes for severity in _SHOWN]
    own = replace(
        settings,
        num_envs=len(cases),
        disturb=disturb_of({key: amount_at(levels, key, 5) for key in axes}),
        episode=replace(settings.episode, end_on_success=False),
    )
    simulation, _ = build(own)
    amounts = {
        key: torch.tensor([amount_at(levels, k, s) if k == key else 0.0 for k, s in cases])
        for key in axes
    }
    first = torch.zeros(len(cases), dtype=torch.int64)
    simulation.deal(torch.arange(len(cases)), first, amounts)
    flight = rollout(simulation, controller(own.definition.teacher, own))
    # Every step is looked at: cameras that deliver late give what they saw before.
    *_, images = (step.images() for step in islice(flight, _STEPS + 1))

    def picture(row: int, block: int, column: int) -> Image.Image:
        camera = own.cameras[block]
        image = images[camera.name][row * len(_SHOWN) + column].numpy()
        return scaled(image, own.renderings[camera.rendering], tile)

    said = [f"severity {severity}" if severity else "undisturbed" for severity in _SHOWN]
    return sheet(axes, own.cams, said, tile, picture)
