"""What is said to a model: text and pictures in turns, and a form for the answer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Picture:
    """An image as the bytes of a PNG file."""

    png: bytes

    @property
    def sha256(self) -> str:
        """Of the bytes; the picture's name in records."""
        return hashlib.sha256(self.png).hexdigest()


Part = str | Picture


@dataclass(frozen=True)
class Message:
    """One turn; ``role`` is ``user`` or ``assistant``."""

    role: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Request:
    """A conversation so far, whose next turn is the model's.

    ``schema`` is the JSON schema of the answer.
    """

    messages: tuple[Message, ...]
    schema: Mapping[str, Any]

    def canonical(self) -> dict[str, Any]:
        """The request as plain values, with the hashes of pictures in their place."""
        return {
            "messages": [
                {"role": message.role, "parts": [_plain(part) for part in message.parts]}
                for message in self.messages
            ],
            "schema": self.schema,
        }

    @property
    def sha256(self) -> str:
        """Of the canonical form: what is said, shown and asked for.

        Who is asked, and with what sampling, is left out: a recording has to be found by
        those who have neither model nor key. A transcript is of one model with one
        sampling (see ``Recorder``), so this confuses nothing.
        """
        text = json.dumps(
            self.canonical(), sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """All pictures, in order."""
        return tuple(
            part for message in self.messages for part in message.parts if isinstance(part, Picture)
        )


def _plain(part: Part) -> dict[str, str]:
    return {"image": part.sha256} if isinstance(part, Picture) else {"text": part}
