"""``needlehoop vlm …``: the commands around vision-language models."""

from __future__ import annotations

from typing import Any

from needlehoop.cli.vlm_ask import add_ask_commands
from needlehoop.cli.vlm_check import add_check_command


def add_commands(commands: Any) -> None:
    """Add ``vlm`` and its commands to the subparsers of ``needlehoop``."""
    summary = "Ask a vision-language model about cameras and rewards; check reward programs."
    parser = commands.add_parser("vlm", help=summary, description=summary)
    below = parser.add_subparsers(dest="action", required=True)
    add_ask_commands(below)
    add_check_command(below)
