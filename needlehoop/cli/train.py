"""``python train.py`` and ``needlehoop train``: Hydra's command line, around ``needlehoop.train``.

It has Hydra's own flags (``-m``, ``--cfg``, ``--help``, …), and knows itself what is wrong with
most command lines before the simulator and the agent are imported.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from needlehoop import config, foresight, sweep


def run(words: Sequence[str], command: str) -> None:
    """Train what a command line asks for: one run, or with ``-m`` several.

    Args:
        words: what was typed after the command.
        command: ``python train.py`` or ``needlehoop train``.

    Raises:
        SystemExit: with one line that names the mistake; or a sweep's run has failed.
    """
    name = command.removeprefix("python ")
    try:
        given, folders = config.prepare(words)
        _check(given, words)
    except ValueError as error:
        sys.exit(f"{name}: {error}")
    if said := foresight.reminder(given):
        print(f"{name}: {said}", file=sys.stderr)

    # A closure, so that a launcher's worker, whose own command line says nothing, knows it too.
    def job(composed: DictConfig) -> None:
        _run_one(composed, command)

    # Where Hydra looks for them.
    sys.argv[1:] = [*given, *(f"--config-dir={folder}" for folder in folders)]
    try:
        hydra.main(config_path=str(config.CONF), config_name="config", version_base="1.3")(job)()
    except KeyboardInterrupt:
        sys.exit(f"{name}: stopped; the same command goes on with a sweep")


def _check(words: Sequence[str], typed: Sequence[str]) -> None:
    """Raises ``ValueError`` for a mistake that Hydra would tell in ten lines or not at all."""
    flags = {word for word in words if word.startswith("-")}
    if flags and flags <= foresight.MULTIRUN:
        config.check_choice(word for word in words if word not in flags)
    elif not flags and not any(word.startswith("+experiment=") for word in words):
        config.compose(typed, "config")


def _run_one(composed: DictConfig, command: str) -> None:
    """One run; under ``-m`` called once for each."""
    values, own = config.plain(composed), HydraConfig.get()
    overrides = list(own.overrides.task)
    if own.mode == RunMode.MULTIRUN:
        values["engine"]["threads"] = values["engine"]["threads"] or sweep.threads(own.launcher)
        if values["existing"] == "auto":
            values["existing"] = "resume"
        note = sweep.identity(values, overrides)
        sweep.attempt(
            lambda: _start(values, overrides, command), Path(own.runtime.output_dir), note
        )
        return
    from needlehoop.rewards import RewardError

    try:
        _start(values, overrides, command)
    except (ValueError, OSError, RewardError) as error:
        sys.exit(f"{command.removeprefix('python ')}: {error}")


def _start(values: dict[str, Any], overrides: list[str], command: str) -> str:
    from needlehoop import rewards

    if values["resume"] is None:
        config.job({**values, "reward": rewards.NONE})
    # What the line before refuses does not wait for this.
    from needlehoop.train import start

    return start(values, overrides, command)
