"""Films of whole episodes: the scene, and beside it what the cameras see."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

from needlehoop.envs.controllers import Controller, rollout
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.pictures.stills import Photographer, scaled
from needlehoop.scene.cameras import in_rows


def record(simulation: Simulation, controller: Controller, episodes: int, out: Path) -> None:
    """A video of whole episodes of one environment: the scene, and beside it what its cameras see.

    ``out``: an ``.mp4`` file; written whole or not at all.
    """
    settings, engine = simulation.settings, simulation.engine
    # A multiple of 16 px.
    photographer = Photographer(engine.model, 480)
    partial = out.with_name(out.stem + ".partial.mp4")
    rate = 1.0 / settings.period
    out.parent.mkdir(parents=True, exist_ok=True)

    try:
        with (
            imageio.get_writer(partial, fps=rate / 2, macro_block_size=16) as video,
            # Half a second a frame on a slow core; nothing is shown where nobody watches.
            tqdm(desc="film", unit="frame", leave=False, disable=None) as bar,
        ):
            for _ in range(episodes):
                for step in rollout(simulation, controller):
                    frame = _frame(settings, photographer(engine.data(0)), simulation.images())
                    bar.update()
                    # An episode's last frame stands for half a second.
                    for _ in range(1 if bool(step.goes_on.any()) else round(rate / 4)):
                        video.append_data(frame)
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)


def _frame(settings: Settings, scene: np.ndarray, images: dict) -> np.ndarray:
    """The scene with a column of the cameras' images, pixel by pixel, at its right.

    The two eyes of a stereo camera are side by side.
    """
    if not images:
        return scene
    height, rows = len(scene), in_rows(settings.cameras, settings.views)
    tile = height // max(3, len(rows)) // 16 * 16
    column = Image.new("RGB", (tile * max(map(len, rows)), height))
    font, edge = ImageFont.load_default(max(9, tile // 12)), tile // 32
    for y, row in enumerate(rows):
        for x, camera in enumerate(row):
            image = images[camera.name][0].cpu().numpy()
            picture = scaled(image, settings.renderings[camera.rendering], tile)
            # The camera's name in the lower left corner, legible on any ground.
            write, at = ImageDraw.Draw(picture).text, (edge, picture.height - edge)
            write(at, camera.name, "white", font, anchor="ls", stroke_width=2, stroke_fill="black")
            column.paste(picture, (x * tile, y * tile))
    return np.concatenate((scene, np.asarray(column)), 1)
