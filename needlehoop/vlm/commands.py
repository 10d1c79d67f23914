"""``needlehoop vlm …``: the commands around vision-language models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needlehoop.vlm.ask_commands import add_ask_commands
from needlehoop.vlm.check_command import add_check_command

if TYPE_CHECKING:
    from needlehoop.vlm.writing import Workshop


def add_commands(commands: Any) -> None:
    """Add ``vlm`` and its commands to the subparsers of ``needlehoop``."""
    summary = "Ask a vision-language model about cameras and rewards; check reward programs."
    parser = commands.add_parser("vlm", help=summary, description=summary)
    below = parser.add_subparsers(dest="action", required=True)
    add_ask_commands(below, workshop)
    add_check_command(below)


def workshop(values: dict[str, Any]) -> Workshop:
    """The language of rewards and its judge, for a composed config."""
    from needlehoop import config
    from needlehoop.vlm.gates import Gates
    from needlehoop.vlm.workshop import open_workshop

    gates = config.as_type(values["gates"], Gates, "gates")
    return open_workshop(config.structure(values), gates)
