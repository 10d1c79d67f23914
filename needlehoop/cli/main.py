"""The ``needlehoop`` command.

Most commands take settings as ``key=value``. Errors in what was asked for are one line on standard
error and exit status 2; a command that judges something says no with exit status 1.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import needlehoop
from needlehoop.cli import demonstrations, evaluate, probe, scenes, study, vlm
from needlehoop.cli.command import COMMANDS
from needlehoop.runs.reading import printable

_FILES = [module.__name__ for module in (scenes, evaluate, demonstrations, probe, vlm, study)]
"""Where commands are, in the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words[:1] == ["train"]:
        # Its flags are Hydra's, and so are its errors: a line, and exit status 1.
        from needlehoop.cli.train import run

        run(words[1:], "needlehoop train")
        return 0
    parser = _parser()
    options, rest = parser.parse_known_args(words)
    flags = [word for word in rest if word.startswith("-")]
    if flags:
        parser.error(f"unknown option {flags[0]}; see `needlehoop {options.command} --help`")
    command = COMMANDS[options.command]
    try:
        if "overrides" in options:
            options.overrides += rest
        elif rest:
            raise ValueError(f"{rest[0]!r} is not understood; it takes one study")
        status = command.run(options)
        # Here, and not when Python ends, which would show a trace if nobody reads any more.
        print(end="", flush=True)
    except KeyboardInterrupt:
        print(f"needlehoop {options.command}: stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # As `needlehoop tasks | head` ends: the reader has gone, and nothing more is printed.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except (ValueError, RuntimeError, OSError, MemoryError) as error:
        print(printable(f"needlehoop {options.command}: {error}"), file=sys.stderr)
        return 2
    return status or 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="needlehoop",
        description="Tasks of a robot: simulate them, look at them, measure them.",
    )
    parser.add_argument(
        "--version", action="version", version=f"needlehoop {needlehoop.__version__}"
    )
    parsers = parser.add_subparsers(dest="command", required=True)
    summary = "Train an agent: python train.py, for those who have no checkout."
    parsers.add_parser("train", help=summary, add_help=False)
    below = {}
    for name, command in sorted(
        COMMANDS.items(), key=lambda entry: _FILES.index(entry[1].run.__module__)
    ):
        group = name.rpartition(" ")[0]
        if group and group not in below:
            several = parsers.add_parser(group, help=vlm.SUMMARY, description=vlm.SUMMARY)
            below[group] = several.add_subparsers(dest="action", required=True)
        command.add(name, below.get(group, parsers))
    return parser


if __name__ == "__main__":
    sys.exit(main())
