"""``needlehoop demonstrations``: episodes as a dataset for other programs."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from needlehoop.cli.command import KEYS, command
from needlehoop.config import composing, strict
from needlehoop.config.changing import parted
from needlehoop.config.options import typed
from needlehoop.config.strict import Count, Seed
from needlehoop.runs.files import new_folder
from needlehoop.runs.machine import import_extra, provenance

if TYPE_CHECKING:
    from needlehoop.demonstrations.episodes import Demonstration


@command(KEYS, config="demonstrations")
def demonstrations(options: argparse.Namespace) -> None:
    """Write episodes of an expert or a trained run as a dataset: Minari, LeRobot or Open-H."""
    from tqdm import tqdm

    from needlehoop.demonstrations.episodes import demonstrate, scripted

    words = options.overrides
    is_run = any(Path(name).is_dir() for name in typed(words, "demonstrator")[-1:])
    run_words = parted(words, "demonstrations")[1] if is_run else []
    conditions = [word for word in run_words if not typed([word], "seed")]
    values = composing.compose((w for w in words if w not in conditions), "demonstrations")
    kinds = {"demonstrator": str | None, "out": str | None, "overwrite": bool, "trust": bool}
    keys = strict.read(values, episodes=Count, format=str, device=str, seed=Seed, **kinds)
    if not keys.out:
        raise ValueError("out: give a folder for the dataset, such as out=demos/smooth-v0")
    out = Path(keys.out)
    write = _writer(keys.format, out.name)
    from needlehoop.envs.settings import settings_from
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import of_run

    if is_run:
        demonstrator, device = keys.demonstrator, pick_device(keys.device)
        seed = keys.seed if typed(words, "seed") else None
        chosen = Path(demonstrator), conditions, seed, device, keys.trust, "demonstrations"
        # evaluate takes the run's final seed, watch the next, this the one after.
        settings, make = of_run(*chosen, later=2)
    else:
        settings = settings_from(values)
        demonstrator = keys.demonstrator or settings.definition.teacher
        make = scripted(demonstrator, settings.definition)
    counts = Counter()

    def shown() -> Iterator[Demonstration]:
        episodes = demonstrate(settings, make, keys.episodes)
        for episode in tqdm(episodes, total=keys.episodes, unit="episode", dynamic_ncols=True):
            counts.update(steps=len(episode), successful=int(episode.success))
            yield episode

    with new_folder(out, keys.overwrite) as folder:
        write(folder, shown(), settings, demonstrator, provenance())
    print(
        f"{out}: {keys.episodes} episodes (seed {settings.seed}), {counts['steps']} steps,"
        f" {counts['successful']} successful"
    )


def _writer(name: str, dataset: str) -> Callable[..., None]:
    """What writes datasets of a format; ``dataset`` is the name of the folder."""
    extras = {"minari": "minari", "lerobot": "lerobot", "open_h": "lerobot"}
    strict.check_names("format", [name], [*extras])
    place = f"needlehoop.demonstrations.{name}_layout"
    layout = import_extra(place, f"format={name}", extras[name])
    if name == "minari" and not re.fullmatch(r"[\w.-]+-v\d+", dataset):
        raise ValueError(
            f"out: {dataset!r} is no name for Minari, which wants a version: such as smooth-v0"
        )
    return layout.write
