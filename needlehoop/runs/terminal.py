"""Text from elsewhere on its way to a terminal, which takes some characters for commands."""

from __future__ import annotations

import re

_COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but for tab and line feed, turns of direction, and halves of characters."""


def printable(text: str) -> str:
    r"""A text with control characters written out, such as ``\x1b``."""
    return _COMMANDS.sub(lambda found: ascii(found[0])[1:-1], text)
