"""The ``needlehoop`` command.

Every command takes Hydra overrides (``key=value``) and a few flags. Errors in what was
asked for are one line on standard error and exit status 2; a command that judges something
says no with exit status 1.
"""

from __future__ import annotations

import argparse
import os
import select
import sys
from collections.abc import Sequence

from needlehoop.cli import bench, demonstrations, export, fly, look, probe, stress, study, vlm
from needlehoop.runs.reading import printable

_TRAIN, _VERSION = "train", "--version"

_UNREAD = 141
"""Exit status where whoever read the output went, as of a program that SIGPIPE ends."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] == [_TRAIN]:
        # Its flags are Hydra's, and so are its errors: a line, and exit status 1.
        from needlehoop.cli.train import run

        run(given[1:], f"needlehoop {_TRAIN}")
        return 0
    if given[:1] == [_VERSION]:
        from importlib.metadata import version

        print(f"needlehoop {version('needlehoop')}")
        return 0
    parser = _parser()
    options, rest = parser.parse_known_args(given)
    flags = [word for word in rest if word.startswith("-")]
    if flags:
        parser.error(f"unknown option {flags[0]}; see `needlehoop {options.command} --help`")
    options.overrides += rest
    try:
        status = options.run(options)
        # Here, and not when Python ends, which would show a trace if nobody reads any more.
        print(end="", flush=True)
    except KeyboardInterrupt:
        print(f"needlehoop {options.command}: stopped", file=sys.stderr)
        return 130
    except (ValueError, RuntimeError, OSError, MemoryError) as error:
        if isinstance(error, BrokenPipeError) and _is_read_no_more():
            return _UNREAD
        print(printable(f"needlehoop {options.command}: {error}"), file=sys.stderr)
        return 2
    return status or 0


def _is_read_no_more() -> bool:
    """Whether it is standard output that is broken; if so, it goes nowhere from here on.

    Another pipe may be as well: that to the program that writes films.
    """
    output = sys.stdout.fileno()
    poll = select.poll()
    poll.register(output, select.POLLOUT)
    if not any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0)):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return True


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="needlehoop",
        description="Tasks of a robot: simulate them, look at them, measure them.",
    )
    parser.add_argument(_VERSION, action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True)
    summary = "Train an agent: python train.py, for those who have no checkout."
    commands.add_parser(_TRAIN, help=summary, add_help=False)
    for group in (look, fly, stress, export, bench, vlm, study, probe, demonstrations):
        group.add_commands(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
