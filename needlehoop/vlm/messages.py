"""What is said to a model, what it replies, and who carries the one to the other."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from PIL import Image
from pydantic import ValidationError
from typing_extensions import TypedDict

PICTURE = 64_000_000
"""Bytes of a picture's file, at most."""


class Turn(TypedDict):
    """A turn of a canonical request: each part has a ``text``, or an ``image`` by its hash."""

    role: str
    parts: list[dict[str, str]]


class Canonical(TypedDict):
    """A request as plain values, with hashes in place of pictures."""

    messages: list[Turn]
    schema: dict[str, Any]


@dataclass(frozen=True)
class Png:
    """A picture as the bytes of a PNG file."""

    png: bytes

    @classmethod
    def of(cls, image: Image.Image, size: int | None = None) -> Png:
        """An image; ``size``: pixels of its longer side, at most."""
        if size is not None:
            image.thumbnail((size, size))
        file = io.BytesIO()
        image.save(file, "PNG")
        return cls(file.getvalue())

    @property
    def sha256(self) -> str:
        """The hash of the bytes, which is the picture's name in records."""
        return hashlib.sha256(self.png).hexdigest()


Part = str | Png


@dataclass(frozen=True)
class Message:
    """One turn; ``role`` is ``user`` or ``assistant``."""

    role: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Request:
    """A conversation so far; the next turn is the model's, an answer of the JSON ``schema``."""

    messages: tuple[Message, ...]
    schema: Mapping[str, Any]

    def canonical(self) -> Canonical:
        """The request as it is hashed and recorded."""
        return {
            "messages": [
                {"role": message.role, "parts": [_plain(part) for part in message.parts]}
                for message in self.messages
            ],
            "schema": dict(self.schema),
        }

    @property
    def sha256(self) -> str:
        """The hash of the canonical form: what is said, shown and asked for.

        It leaves out who is asked and with what sampling, because people without a model or a
        key must find a recording too. A transcript has one model and one sampling (see
        ``Record``), so no two requests in it are confused.
        """
        text = json.dumps(
            self.canonical(), sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Reply:
    """What a model returned.

    ``outcome`` is ``answered``, ``truncated`` (cut off at the limit of length), ``refused`` (by
    the model or by a filter) or ``empty``. ``detail`` is the reason in the provider's words.
    Tokens are ``None`` if they were not reported. ``attempts`` are the statuses of all tries.
    """

    outcome: str
    answer: str
    detail: str
    answered_by: str | None
    tokens_in: int | None
    tokens_out: int | None
    attempts: tuple[int | str, ...] = ()


class ProviderError(RuntimeError):
    """A request got no reply.

    ``status`` is the HTTP status, or ``timeout``, ``unreachable`` or ``unreadable``; ``attempts``
    as in ``Reply``.
    """

    def __init__(self, message: str, status: int | str, attempts: tuple[int | str, ...] = ()):
        super().__init__(message)
        self.status, self.attempts = status, attempts

    @property
    def passing(self) -> bool:
        """Whether another try may bring a reply."""
        if isinstance(self.status, int):
            return self.status in (408, 429) or self.status >= 500
        return self.status in ("timeout", "unreadable")


class UnansweredError(RuntimeError):
    """Nobody answered in time. Nothing is lost, and nothing is recorded."""


class Provider(Protocol):
    """Somebody who answers."""

    @property
    def who(self) -> Mapping[str, Any]:
        """Provider, model and sampling, for the record."""
        ...

    def ask(self, request: Request) -> Reply:
        """The reply; ``ProviderError`` if there is none."""
        ...

    def close(self) -> None:
        """Put away what was answered."""
        ...


def _plain(part: Part) -> dict[str, str]:
    return {"image": part.sha256} if isinstance(part, Png) else {"text": part}


def mistakes(error: ValidationError, whole: str = "all of it", most: int = 1) -> list[str]:
    """What is wrong in values that have another form, by field; ``whole`` names no field."""
    wrong = error.errors(include_url=False, include_context=False, include_input=False)[:most]
    return [f"{'.'.join(map(str, one['loc'])) or whole}: {one['msg']}" for one in wrong]
