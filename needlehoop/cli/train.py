"""``python train.py`` and ``needlehoop train``: Hydra's command line, with its own flags."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from needlehoop.config import composing
from needlehoop.runs.machine import terminable
from needlehoop.runs.reading import printable, read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.training import sweep

KNOWN = (ValueError, OSError, ArithmeticError, MemoryError, HydraException)
"""What tells of a mistake or of the machine: a line will do. All else is ours, with its trace."""


def run(words: Sequence[str], command: str) -> None:
    """Train what a command line asks for: one run, or with ``-m`` several.

    ``command`` is ``python train.py`` or ``needlehoop train``. Raises ``SystemExit`` with one line
    that names the mistake, or where a sweep's run has failed.
    """
    if {"-h", "--help"} & {*words}:
        # Hydra would first look up each option of each group, for seconds.
        print(read_yaml(CONF / "config.yaml")["hydra"]["help"]["template"], end="")
        return
    name = command.removeprefix("python ")
    with _in_a_line(name):
        arguments, _ = composing.prepare(words)

    # A closure: the process of a launcher has another command line.
    def job(composed: DictConfig) -> float:
        # Hydra has folders of one's own in its search path, and not among a run's words.
        folders = [word for word in words if word.startswith("conf_dir=")]
        return _run_one(composed, command, arguments, folders)

    # Hydra's parser takes settings in one piece, after its flags.
    command_line = [*arguments, *sweep.direction(arguments)]
    sys.argv[1:] = sorted(command_line, key=lambda word: "=" in word and not word.startswith("-"))
    # Hydra raises errors instead of printing them.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    main = hydra.main(config_path=str(CONF), config_name="config", version_base="1.3")
    try:
        # A scheduler's SIGTERM stops a sweep as Ctrl-C does.
        with _in_a_line(name), terminable(), composing.explained("config"):
            main(job)()
    except KeyboardInterrupt:
        sys.exit(f"{name}: stopped; the same command goes on with a sweep")


@contextmanager
def _in_a_line(name: str) -> Iterator[None]:
    """Ends the process with one line for what is known to go wrong."""
    try:
        yield
    except Exception as error:
        # By its name: to import rewards takes seconds, and a misspelt key is told at once.
        if not isinstance(error, KNOWN) and type(error).__name__ != "RewardError":
            raise
        first = next(iter(str(error).strip().splitlines()), "") or type(error).__name__
        sys.exit(f"{name}: {printable(first)}")


def _run_one(
    composed: DictConfig, command: str, typed: Sequence[str], folders: Sequence[str]
) -> float:
    """One run; under ``-m`` called once for each. Its objective, for a sweeper that searches."""
    from needlehoop.training.loop import start

    values, conf = composing.plain(composed), HydraConfig.get()
    overrides = [*folders, *conf.overrides.task]
    if conf.mode != RunMode.MULTIRUN:
        # Hydra would print all settings before it passed an error on.
        with _in_a_line(command.removeprefix("python ")):
            return start(values, overrides, command)[1]
    words = [word for word in typed if not word.startswith("-")]
    values["label"] = sweep.label_of(values, words, conf.sweeper.params or {}, conf.overrides.task)
    values["engine"]["threads"] = values["engine"]["threads"] or sweep.threads(conf.launcher)
    values["existing"] = "resume" if values["existing"] == "auto" else values["existing"]
    share = partial(start, values, overrides, command)
    return sweep.attempt(share, Path(conf.runtime.output_dir), sweep.identity(values, overrides))
