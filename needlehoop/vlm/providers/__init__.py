"""Those who answer: models behind servers, or a person with a chat window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from needlehoop.vlm.config import AskingConfig, ManualConfig
from needlehoop.vlm.messages import Request


@dataclass(frozen=True)
class Reply:
    """What a model returned.

    ``outcome`` is ``answered``, ``truncated`` (cut off at the limit of length), ``refused`` (by
    the model or by a filter) or ``empty``. ``detail`` is the reason in the provider's words.
    ``answered_by`` is the model. Tokens are ``None`` if they were not reported. ``attempts`` are
    the statuses of all tries, the last one included.
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


def build_provider(config: AskingConfig, folder: Path) -> Provider:
    """A provider by its kind. It sends nothing yet; errors as in ``Server``.

    ``folder`` is the study's record, for providers that ask by files.
    """
    if isinstance(config, ManualConfig):
        from needlehoop.vlm.providers.manual import Manual

        return Manual(config, folder)
    from needlehoop.vlm.providers.server import Server

    return Server(config)
