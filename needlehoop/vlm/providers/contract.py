"""Providers: their settings, what they return, and how they fail."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol

from needlehoop.config.strict import Range
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.vlm.config import OneOf
from needlehoop.vlm.messages import Request
from needlehoop.vlm.transcript import TRANSCRIPT


@dataclass(frozen=True)
class Reply:
    """What a model returned.

    ``outcome`` is ``answered``, ``truncated`` (cut off at the limit of length), ``refused`` (by
    the model or by a filter) or ``empty``. ``detail`` is the reason in the provider's words.
    ``model`` is the one that answered. Tokens are ``None`` if they were not reported.
    """

    outcome: str
    answer: str
    detail: str
    model: str
    tokens_in: int | None
    tokens_out: int | None


class ProviderError(RuntimeError):
    """A request got no reply.

    ``status`` is the HTTP status, or ``timeout``, ``unreachable`` or ``unreadable``.
    ``attempts`` are the statuses of all tries, the last one included.
    """

    def __init__(self, message: str, status: int | str, attempts: tuple[int | str, ...] = ()):
        super().__init__(message)
        self.status = status
        self.attempts = attempts

    @property
    def passing(self) -> bool:
        """Whether another try may bring a reply."""
        if isinstance(self.status, int):
            return self.status in (408, 429) or self.status >= 500
        return self.status in ("timeout", "unreadable")


DEFAULT = "claude"
"""The shipped recording that is replayed if no other is named."""


def transcripts() -> dict[str, Path]:
    """The shipped recordings that can be replayed, by name."""
    return {file.parent.name: file.parent for file in sorted(RECORDINGS.glob(f"*/{TRANSCRIPT}"))}


Told = Annotated[str, OneOf(("full", "names", "nothing"))]
"""How much a model is told of the task when it ranks cameras or writes a reward."""


@dataclass(frozen=True)
class ReplayConfig:
    """Values in ``conf/vlm/replay.yaml``."""

    kind: str
    recording: str | None
    """A shipped recording's name, or a folder with a transcript; ``None`` is the study's own where
    it has one, else ``DEFAULT``."""
    told: Told = "full"

    def folder(self, own: Path) -> Path:
        """The folder of the answers; ``own`` is the study's."""
        shipped = transcripts()
        if self.recording is None:
            return own if (own / TRANSCRIPT).exists() else shipped[DEFAULT]
        return shipped[self.recording] if self.recording in shipped else Path(self.recording)


@dataclass(frozen=True)
class LiveConfig:
    """Values in ``conf/vlm/gemini.yaml`` and ``conf/vlm/openai.yaml``."""

    kind: str
    model: str
    key: str | None
    """Environment variable that holds the key; ``None`` for servers without keys."""
    base_url: str | None
    """The server's address; ``None`` is the provider's own."""
    sampling: Mapping[str, Any]
    """Sent by name, except for ``None``."""
    timeout: Annotated[float, Range(0.0, 86_400.0, above=True)]
    """Seconds that one try may take in all."""
    tries: Annotated[int, Range(1, 1000)]
    first_wait: Annotated[float, Range(0.0, 86_400.0)]
    """Seconds before the second try; they double with each further one."""
    longest_wait: Annotated[float, Range(0.0, 86_400.0)]
    told: Told = "full"

    arrived: ClassVar[int] = 200
    """The status of a try that brought a reply."""

    def __post_init__(self) -> None:
        if self.key is not None and not re.fullmatch(r"[A-Z][A-Z0-9_]{1,60}", self.key):
            # The value is not shown: it may be the key itself.
            raise ValueError(
                "vlm.key: give the name of an environment variable, such as GEMINI_API_KEY"
            )

    @property
    def asked(self) -> dict[str, Any]:
        """Who is asked and how, for the record."""
        return {"provider": self.kind, "model": self.model, "sampling": self.sent}

    @property
    def sent(self) -> dict[str, Any]:
        """The sampling settings that are sent."""
        return {name: value for name, value in self.sampling.items() if value is not None}

    def read_key(self) -> str | None:
        """The key.

        Raises:
            ValueError: its variable is not set.
        """
        if self.key is None:
            return None
        value = os.environ.get(self.key, "").strip()
        if not value:
            raise ValueError(
                f"vlm.key: the environment variable {self.key} is not set; set it to your key,"
                " or replay a recording with vlm=replay"
            )
        return value


@dataclass(frozen=True)
class ManualConfig:
    """Values in ``conf/vlm/manual.yaml``."""

    kind: str
    model: str
    wait: Annotated[float, Range(0.0, 1e9)] | None
    """Seconds to wait for an answer; ``None`` waits for ever."""
    poll: Annotated[float, Range(0.0, 86_400.0, above=True)]
    """Seconds between two looks for it."""
    told: Told = "full"

    tries: ClassVar[int] = 1
    first_wait: ClassVar[float] = 0.0
    longest_wait: ClassVar[float] = 0.0
    arrived: ClassVar[str] = "by hand"

    def __post_init__(self) -> None:
        if not self.model.strip():
            raise ValueError("vlm.model: say who answers, for the record")

    @property
    def asked(self) -> dict[str, Any]:
        """Who is asked, for the record."""
        return {"provider": self.kind, "model": self.model, "sampling": {}}


AskingConfig = LiveConfig | ManualConfig
"""The settings of a provider that gives new answers."""

KINDS: dict[str, type[ReplayConfig | LiveConfig | ManualConfig]] = {
    "replay": ReplayConfig,
    "gemini": LiveConfig,
    "openai": LiveConfig,
    "manual": ManualConfig,
}
"""The type of settings of each ``vlm.kind``."""


def config_of(kind: str) -> type[ReplayConfig | LiveConfig | ManualConfig]:
    """The type of a kind's settings; ``ValueError`` for an unknown kind."""
    if kind not in KINDS:
        raise ValueError(f"vlm.kind: {kind!r} is unknown; choose from {', '.join(KINDS)}")
    return KINDS[kind]


class UnansweredError(RuntimeError):
    """Nobody answered in time. Nothing is lost, and nothing is recorded."""


class Provider(Protocol):
    """Somebody who answers."""

    def ask(self, request: Request) -> Reply:
        """One try; ``ProviderError`` if there is no reply."""
        ...

    def close(self) -> None:
        """Let go of connections."""
        ...
