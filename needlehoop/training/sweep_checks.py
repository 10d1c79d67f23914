"""What is checked and said before a sweep's first run."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback

from needlehoop.config import composing
from needlehoop.runs.files import listed

MULTIRUN = {"-m", "--multirun"}

_SEARCH, _DIRECTION = "hydra/sweeper=optuna", "hydra.sweeper.direction="

_PLUGINS = {
    "hydra/launcher=joblib": "joblib_launcher",
    "hydra/launcher=ray": "ray_launcher",
    "hydra/launcher=slurm": "submitit_launcher",
    _SEARCH: "optuna_sweeper",
}
"""Packages, ``hydra_plugins.hydra_<name>``, by what is typed; its value is the extra's name."""


def check_plugin(word: str) -> None:
    """Raises ``ValueError`` for a launcher or a sweeper of Hydra's that is not installed."""
    if word not in _PLUGINS:
        return
    try:
        found = find_spec(f"hydra_plugins.hydra_{_PLUGINS[word]}")
    except ModuleNotFoundError:
        found = None
    if found is None:
        raise ValueError(
            f"{word} is not installed: pip install 'needlehoop[{word.partition('=')[2]}]'"
        )


def reminder(words: Sequence[str]) -> str | None:
    """A hint for ``-m cams=a,b``, where one run with both cameras may have been meant.

    Returns:
        A line, if all that was typed after ``cams=`` are cameras of different views.
    """
    if not MULTIRUN & set(words):
        return None
    for word in words:
        key, _, value = word.partition("=")
        names = [name.strip() for name in value.split(",")]
        views = {name.partition("_")[2] for name in names}
        if key == "cams" and "[" not in value and len(views) == len(names) > 1 and all(views):
            return (
                f"-m {word} is {len(names)} runs of one camera each; one run that sees them all is"
                f" 'cams=[{','.join(names)}]'"
            )
    return None


def direction(words: Sequence[str]) -> list[str]:
    """What a search is told beside what was typed: to make its objective high, not low."""
    is_told = any(word.startswith(_DIRECTION) for word in words)
    return [f"{_DIRECTION}maximize"] if _SEARCH in words and not is_told else []


class Programs(Callback):
    """Before a sweep's first run: refuses missing or bad reward programs, sets joblib up."""

    def on_multirun_start(self, config: Any, **kwargs: Any) -> None:
        """Called by Hydra where the sweep is started, with the config of the sweep itself."""
        if str(config.hydra.launcher._target_).endswith(".JoblibLauncher"):
            from needlehoop.training.side_by_side import use_own_processes

            use_own_processes()
        sweeper, typed = config.hydra.sweeper, config.hydra.overrides.task
        # Another sweeper decides later what it runs.
        if not sweeper._target_.endswith(".BasicSweeper"):
            return
        params = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
        try:
            words = [*params, *typed]
            # Folders of one's own are among Hydra's settings.
            place = [w for w in config.hydra.overrides.hydra if w.startswith("hydra.searchpath=")]
            runs, seeds = parted(words)
            found = wrong_programs([[*place, *run] for run in runs], seeds)
        except ValueError as error:
            sys.exit(f"nothing was started: {error}")
        if found:
            sys.exit("\n".join(("nothing was started: these rewards cannot be had", *found)))


def parted(words: Iterable[str]) -> tuple[list[list[str]], list[Any]]:
    """A sweep's runs without seeds, as Hydra's basic sweeper makes them; and its seeds, if any."""
    runs, seeds = [], []
    for one in OverridesParser.create().parse_overrides(list(words)):
        if one.get_key_element() == "seed":
            seeds = [*one.sweep_iterator()] if one.is_sweep_override() else [one.value()]
        else:
            runs.append(one)
    return [*BasicSweeper.split_arguments(runs, None)[0]], seeds


def wrong_programs(runs: Iterable[list[str]], seeds: Sequence[Any]) -> list[str]:
    """What is wrong with the programs of runs, a line for each.

    A program that is not there is no mistake where a model will be asked to write it.

    Args:
        seeds: of each; none: that of the config.

    Raises:
        ValueError: another mistake in the settings of a run.
    """
    from needlehoop import rewards
    from needlehoop.rewards import written
    from needlehoop.tasks.registry import find
    from needlehoop.training.options import check_options

    lines: dict[str, None] = {}
    for run in runs:
        values = composing.compose_here(run, "config")
        for seed in seeds or [values["seed"]]:
            check_options({**values, "seed": seed})
        reward: Mapping[str, Any] = values["reward"]
        if reward["kind"] not in written.KINDS or values["resume"] is not None:
            continue
        if not written.is_recorded(reward):
            if values["vlm"]["kind"] != "replay":
                continue
            flavour, cams = written.FLAVOURS[reward["kind"]], listed(reward["cams"])
            asking = written.command(cams, flavour, str(reward["study"]), str(reward["results"]))
            lines[f"  {'+'.join(cams)}: none of {flavour}; make it with: {asking}"] = None
            continue
        try:
            rewards.load(reward, find(values["task"]["name"]))
        except ValueError as error:
            lines[f"  {error}"] = None
    return list(lines)
