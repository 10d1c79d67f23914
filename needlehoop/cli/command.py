"""What a command of ``needlehoop`` is, and what several of them share.

A command is a function of the parsed arguments. Its docstring is its help; ``None`` as its exit
status is 0.
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from textwrap import fill
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

from needlehoop.config import changing, composing, strict
from needlehoop.runs.files import check_free
from needlehoop.runs.shipped import CONF

if TYPE_CHECKING:
    from needlehoop.envs.settings import Settings

Run = Callable[[argparse.Namespace], int | None]


def argument(*names: str, **settings: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    """An argument, as argparse takes it."""
    return names, settings


KEYS = argument("overrides", nargs="*", metavar="key=value")
JSON = argument("--json", action="store_true", help="print one line of JSON")


class Command(NamedTuple):
    """A command, by its name in ``COMMANDS``."""

    run: Run
    arguments: tuple[tuple[tuple[str, ...], dict[str, Any]], ...]
    config: str | None
    """``conf/<config>.yaml`` has its keys."""

    def add(self, name: str, parsers: Any) -> None:
        """Add its parser to those of argparse; the help shows its config."""
        summary, *more = inspect.getdoc(self.run).split("\n\n")  # pyright: ignore
        parser = parsers.add_parser(
            name.split()[-1],
            help=summary,
            description="\n\n".join(fill(text, 80) for text in (summary, *more)),
            epilog=self.config and f"keys, with their defaults:\n\n{_keys(self.config)}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        for names, settings in self.arguments:
            parser.add_argument(*names, **settings)
        parser.set_defaults(command=name)


COMMANDS: dict[str, Command] = {}


def command(
    *arguments: tuple[tuple[str, ...], dict[str, Any]], config: str | None = None
) -> Callable[[Run], Run]:
    """A decorator that makes a command of a function; ``vlm_rank`` is ``needlehoop vlm rank``."""

    def add(run: Run) -> Run:
        COMMANDS[run.__name__.replace("_", " ")] = Command(run, arguments, config)
        return run

    return add


def _keys(config: str) -> str:
    """A config of ``conf/`` with its comments, and those it builds on; ``env`` by its name."""
    if config == "env":
        return "All of conf/env.yaml and its groups, such as task=wide or seed=1."
    text = (CONF / f"{config}.yaml").read_text()
    match = re.fullmatch(r"(?:#[^\n]*\n)?(?:defaults:\n(.*?)  - _self_\n)?(.*)", text, re.DOTALL)
    assert match is not None
    below = re.findall(r"^  - (\w+)$", match[1] or "", re.MULTILINE)
    return "\n".join([match[2].strip("\n") + "\n", *map(_keys, below)])


def environment(
    options: argparse.Namespace, config: str = "env", **kinds: Any
) -> tuple[Settings, SimpleNamespace]:
    """The environment that a command's words describe, and its own keys, of these ``kinds``."""
    values = composing.compose(options.overrides, config)
    # A misspelt key does not wait for the simulator.
    from needlehoop.envs.settings import settings_from

    return settings_from(values), strict.read(values, **kinds)


def beside_a_run(
    options: argparse.Namespace, command: str, **kinds: Any
) -> tuple[SimpleNamespace, list[str]]:
    """A command's own keys, of these ``kinds``, and the words that change the run's settings."""
    keys, conditions = changing.parted(options.overrides, command)
    values = composing.compose(keys, command)
    return strict.read(values, trust=bool, device=str, **kinds), conditions


def new_file(out: str | Path, suffix: str, overwrite: bool, key: str = "out") -> Path:
    """The path of a file, or without a suffix of a folder, that is to be written.

    Raises ``ValueError`` for another suffix, or where something is and may not be overwritten.
    """
    path = Path(out)
    if suffix and path.suffix.lower() != suffix:
        raise ValueError(f"{key}: {str(out)!r} must end in {suffix}")
    check_free(path, overwrite, key)
    return path
