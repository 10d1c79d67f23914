"""What is said to a model, what it replies, and the provider that carries one to the other."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from PIL import Image
from pydantic import ValidationError


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

    def canonical(self) -> dict[str, Any]:
        """The request as it is hashed and recorded, with hashes in place of pictures."""

        def plain(part: Part) -> dict[str, str]:
            return {"image": part.sha256} if isinstance(part, Png) else {"text": part}

        messages = [{"role": m.role, "parts": [*map(plain, m.parts)]} for m in self.messages]
        return {"messages": messages, "schema": dict(self.schema)}

    @property
    def sha256(self) -> str:
        """The hash of the canonical form: what is said, shown and asked for.

        It leaves out the model and the sampling, because a recording must be found without them.
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
    Tokens are ``None`` if they were not reported. ``attempts`` has the statuses of the tries that
    are known: an SDK that tries again itself tells the last one only.
    """

    outcome: str
    answer: str
    detail: str
    answered_by: str | None
    tokens_in: int | None
    tokens_out: int | None
    attempts: tuple[int | str, ...] = ()


class ProviderError(RuntimeError):
    """A request got no reply; ``status`` is the HTTP status, ``timeout`` or ``unreachable``."""

    def __init__(self, message: str, status: int | str):
        super().__init__(message)
        self.status = status


class Provider(Protocol):
    """A model behind a server, or a person."""

    who: dict[str, Any]
    """Provider, model and sampling, for the record."""

    def ask(self, request: Request) -> Reply:
        """The reply; ``ProviderError`` if there is none."""
        ...


def mistakes(error: ValidationError, whole: str = "all of it", most: int = 1) -> str:
    """What is wrong in values, by field; ``whole`` stands for no field."""
    wrong = error.errors(include_url=False, include_context=False, include_input=False)[:most]
    return "; ".join(f"{'.'.join(map(str, item['loc'])) or whole}: {item['msg']}" for item in wrong)
