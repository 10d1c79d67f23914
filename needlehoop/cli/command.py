"""A command of ``needlehoop`` that takes an environment's settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    summary: str,
    keys: str,
) -> argparse.ArgumentParser:
    """Add a command whose words are ``overrides`` of a config.

    Args:
        commands: the subparsers to add it to.
        name: of the command.
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
