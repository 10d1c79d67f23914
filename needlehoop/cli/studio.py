"""``needlehoop studio``: the page on which cameras are placed."""

from __future__ import annotations

import argparse
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

from needlehoop.cli.command import KEYS, beside_a_run, command
from needlehoop.cli.scenes import Levels
from needlehoop.config.options import part, typed, variants
from needlehoop.config.strict import Pixels, Range
from needlehoop.runs.shipped import CONF

_FOLDER = "my_conf"
"""Where views are saved if no ``conf_dir`` is typed."""


@command(KEYS, config="studio")
def studio(options: argparse.Namespace) -> None:
    """Place cameras on a page in the browser, see what the agent sees, watch it act.

    The page is http://127.0.0.1:8080. Views are saved into conf_dir=. Ctrl-C ends it.
    """
    if find_spec("viser") is None:
        raise ValueError("studio needs viser: pip install 'needlehoop[studio]'")
    kinds: dict[str, Any] = {"host": str, "port": Annotated[int, Range(0, 65_535)], "results": str}
    kinds |= {"run": str | None, "size": Pixels, "levels": Levels}
    asked, words = beside_a_run(options, "studio", **kinds)
    run = None if asked.run is None else Path(asked.run)
    import torch

    from needlehoop.envs.settings import Settings, compose_settings
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import flown_job
    from needlehoop.runs.run import Run
    from needlehoop.studio.page import Page, Source
    from needlehoop.studio.players import players
    from needlehoop.studio.world import World

    def scene(*changed: str) -> Settings:
        kept = [word for word in words if not (changed and word.startswith("task="))]
        if run is None:
            return compose_settings([*kept, *changed])
        return flown_job(Run.open(run, "run").config(), [*kept, *changed], asked.trust)[0].env

    # A policy of a few layers is fastest on one.
    torch.set_num_threads(1)
    settings = scene()
    _, folders = part(words)
    who = players(settings, run, asked.trust, pick_device(asked.device))
    named = [camera.rendering for camera in settings.cameras]
    plain = sorted(settings.renderings, key=lambda name: settings.renderings[name].depth != "none")
    rendering, *_ = *named, *plain
    liked = ("last policy", "best policy", settings.definition.teacher, *who)
    first = next(name for name in liked if name in who)
    world = World(settings, who, asked.levels, rendering, first, asked.size)
    names = variants(settings.task.name, [CONF, *folders])
    source = Source(
        layouts={"as given": scene} | {one: partial(scene, f"task={one}") for one in names},
        words=[w for w in words if not w.startswith(("cams=", "conf_dir="))],
        conf_dir=next(iter(typed(words, "conf_dir")), _FOLDER),
        results=asked.results,
    )
    page = Page(world, source, asked.host, asked.port)
    try:
        print("Ctrl-C ends it.", flush=True)
        page.run(settings.period)
    except KeyboardInterrupt:
        print("studio: closed")
    finally:
        page.close()
