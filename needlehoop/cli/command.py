"""What the commands of ``needlehoop`` that take an environment's settings share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from needlehoop.envs.settings import Settings


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    summary: str,
    keys: str,
) -> argparse.ArgumentParser:
    """Add a command whose words are ``overrides`` of a config.

    Args:
        run: does it; what it returns is the exit status, ``None`` is 0.
        summary: one sentence for the help.
        keys: its own keys, beside those of ``conf/env.yaml``.

    Returns:
        Its parser, for flags of its own.
    """
    command = commands.add_parser(
        name,
        help=summary,
        description=summary,
        epilog=f"Keys: {keys}; and all of conf/env.yaml, such as task=wide or seed=1.",
    )
    command.add_argument("overrides", nargs="*", metavar="key=value")
    command.set_defaults(run=run)
    return command


def environment(
    options: argparse.Namespace, config: str = "env"
) -> tuple[Settings, dict[str, Any]]:
    """The environment that a command's words describe, and all values of its config."""
    from needlehoop.config import composing

    values = composing.compose(options.overrides, config)
    # A misspelt key does not wait for the simulator.
    from needlehoop.envs.settings import settings_from

    return settings_from(values), values


def new_file(out: str | Path, suffix: str, overwrite: bool, key: str = "out") -> Path:
    """The path of a file, or with no suffix of a folder, that is to be written.

    Raises:
        ValueError: another suffix, or something is there and may not be overwritten.
    """
    path = Path(out)
    if suffix and path.suffix.lower() != suffix:
        raise ValueError(f"{key}: {str(out)!r} must end in {suffix}")
    if path.exists() and not overwrite:
        raise ValueError(f"{key}: {str(out)!r} exists; choose another or say overwrite=true")
    return path
