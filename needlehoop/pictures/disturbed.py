"""One sheet of what a camera shows under each axis of disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from needlehoop.disturbances.config import AXES, amount_at, disturb_of
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import Settings
from needlehoop.pictures.stills import to_rgb

_STEPS = 10
"""Steps of the expert before the picture is taken: late and frozen pictures show then."""

_INK, _PAPER = (40, 40, 40), (255, 255, 255)


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
    shown = (0, 1, 3, 5)
    cases = [(key, severity) for key in axes for severity in shown]

    own = replace(
        settings,
        num_envs=len(cases),
        disturb=disturb_of({key: amount_at(levels, key, 5) for key in axes}),
        episode=replace(settings.episode, end_on_success=False),
    )
    simulation, imager = build(own)
    everywhere = torch.arange(len(cases))
    amounts = {
        key: torch.tensor([amount_at(levels, k, s) if k == key else 0.0 for k, s in cases])
        for key in axes
    }
    simulation.deal(everywhere, torch.zeros(len(cases), dtype=torch.int64), amounts)
    moment, act = simulation.reset(), controller(own.definition.teacher, own)
    images = simulation.images(imager)
    for _ in range(_STEPS):
        moment = simulation.step(act(moment.signals))
        images = simulation.images(imager)
    label, head, gap = tile * 2, tile // 3, max(2, tile // 32)
    width = label + len(own.cams) * (len(shown) * (tile + gap) + tile // 4)
    sheet = Image.new("RGB", (width, 2 * head + len(axes) * (tile + gap)), _PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(tile // 5)
    for row, key in enumerate(axes):
        y = 2 * head + row * (tile + gap)
        draw.text((label - gap * 3, y + tile // 2), key, _INK, font=font, anchor="rm")
    for place, camera in enumerate(own.cameras):
        left = label + place * (len(shown) * (tile + gap) + tile // 4)
        middle = left + len(shown) * (tile + gap) // 2
        draw.text((middle, head // 2), camera.name, _INK, font=font, anchor="mm")
        for column, severity in enumerate(shown):
            x = left + column * (tile + gap)
            said = f"severity {severity}" if severity else "undisturbed"
            draw.text((x + tile // 2, 3 * head // 2), said, _INK, font=font, anchor="mm")
            for row in range(len(axes)):
                image = images[camera.name][row * len(shown) + column].numpy()
                seen = to_rgb(image, own.renderings[camera.rendering].depth)
                picture = Image.fromarray(np.ascontiguousarray(seen))
                at = (x, 2 * head + row * (tile + gap))
                sheet.paste(picture.resize((tile, tile), Image.Resampling.NEAREST), at)
    return sheet
