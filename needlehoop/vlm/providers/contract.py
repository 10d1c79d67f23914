"""Those who answer: what they are told, what they give back, how they fail."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol

from needlehoop.config.strict import Range
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.runs.terminal import printable
from needlehoop.vlm.messages import Request

OUTCOMES = ("answered", "truncated", "refused", "empty", "failed")


@dataclass(frozen=True)
class Reply:
    """What came back from a model.

    ``outcome`` is ``answered``, ``truncated`` (cut off at the limit of length), ``refused``
    (by the model or by a filter) or ``empty``; ``detail`` says why, in the provider's
    words. ``model`` is the one that answered. Tokens are ``None`` where not reported.
    """

    outcome: str
    answer: str
    detail: str
    model: str
    tokens_in: int | None
    tokens_out: int | None


class ProviderError(RuntimeError):
    """A request that brought no reply.

    ``status`` is the HTTP status, or ``timeout``, ``unreachable`` or ``unreadable``;
    ``attempts`` are the statuses of all tries, this one last.
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


def transcripts() -> dict[str, Path]:
    """The shipped recordings that can be replayed, by name."""
    return {file.parent.name: file.parent for file in sorted(RECORDINGS.glob("*/transcript.jsonl"))}


@dataclass(frozen=True)
class ReplayConfig:
    """Values in ``conf/vlm/replay.yaml``."""

    kind: str
    recording: str | None
    """A shipped recording's name, or a folder with a transcript; ``None`` is the study's own."""

    def folder(self, own: Path) -> Path:
        """Where the answers are.

        Args:
            own: the study's folder.
        """
        if self.recording is None:
            return own
        shipped = transcripts()
        return shipped[self.recording] if self.recording in shipped else Path(self.recording)


@dataclass(frozen=True)
class LiveConfig:
    """Values in ``conf/vlm/gemini.yaml`` and ``conf/vlm/openai.yaml``."""

    kind: str
    model: str
    key: str | None
    """Environment variable that holds the key; ``None`` for servers that ask for none."""
    base_url: str | None
    """The server's address; ``None`` is the provider's own."""
    sampling: Mapping[str, Any]
    """Passed on by name; ``None`` is not sent."""
    timeout: Annotated[float, Range(0.0, 86_400.0, above=True)]
    """Seconds that one try may take, from its first byte to its last."""
    tries: Annotated[int, Range(1, 1000)]
    first_wait: Annotated[float, Range(0.0, 86_400.0)]
    """Seconds before the second try; they double with each further one."""
    longest_wait: Annotated[float, Range(0.0, 86_400.0)]

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise ValueError(f"vlm.tries: {self.tries} must be at least 1")
        if not self.timeout > 0:
            raise ValueError(f"vlm.timeout: {self.timeout} must be positive")
        for key in ("first_wait", "longest_wait"):
            if getattr(self, key) < 0:
                raise ValueError(f"vlm.{key}: {getattr(self, key)} is negative")
        if self.key is not None and not re.fullmatch(r"[A-Z][A-Z0-9_]{1,60}", self.key):
            # Not repeated: it may be the key itself.
            raise ValueError(
                "vlm.key: give the name of an environment variable, such as GEMINI_API_KEY"
            )

    @property
    def asked(self) -> dict[str, Any]:
        """Who is asked and how, for the record."""
        return {"provider": self.kind, "model": self.model, "sampling": self.sent}

    @property
    def arrived(self) -> int:
        """The status of a try that brought a reply."""
        return 200

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
    """Seconds to wait for an answer; ``None``: for ever."""
    poll: Annotated[float, Range(0.0, 86_400.0, above=True)]
    """Seconds between two looks for it."""

    tries: ClassVar[int] = 1
    first_wait: ClassVar[float] = 0.0
    longest_wait: ClassVar[float] = 0.0
    arrived: ClassVar[str] = "by hand"

    def __post_init__(self) -> None:
        if not self.model.strip():
            raise ValueError("vlm.model: say who answers, for the record")
        if self.wait is not None and self.wait < 0:
            raise ValueError(f"vlm.wait: {self.wait} is negative")
        if not self.poll > 0:
            raise ValueError(f"vlm.poll: {self.poll} must be positive")

    @property
    def asked(self) -> dict[str, Any]:
        """Who is asked, for the record."""
        return {"provider": self.kind, "model": self.model, "sampling": {}}


AskingConfig = LiveConfig | ManualConfig
"""Of those who answer anew."""

KINDS: dict[str, type[ReplayConfig] | type[LiveConfig] | type[ManualConfig]] = {
    "replay": ReplayConfig,
    "gemini": LiveConfig,
    "openai": LiveConfig,
    "manual": ManualConfig,
}
"""The config of each ``vlm.kind``."""


def config_of(kind: str) -> type[ReplayConfig] | type[LiveConfig] | type[ManualConfig]:
    """Raises ``ValueError`` for a kind that there is not."""
    if kind not in KINDS:
        raise ValueError(f"vlm.kind: {kind!r} is unknown; choose from {', '.join(KINDS)}")
    return KINDS[kind]


class UnansweredError(RuntimeError):
    """Nobody answered in the time given; nothing is lost, and nothing is recorded."""


class Provider(Protocol):
    """A model behind a server."""

    def ask(self, request: Request) -> Reply:
        """One try.

        Raises:
            ProviderError: no reply.
        """
        ...

    def close(self) -> None:
        """Let go of connections."""
        ...


def lacking(kind: str, package: str) -> RuntimeError:
    """The error for a provider whose package is not there."""
    return RuntimeError(
        f"vlm={kind} needs {package}; install it with: pip install 'needlehoop[vlm]'"
    )


def failure(config: LiveConfig, key: str | None, status: int | str, said: str) -> ProviderError:
    """A ``ProviderError`` in one line, without the key and control characters of a server's."""
    if key:
        said = said.replace(key, "***")
    said = printable(re.sub(r"\s+", " ", said)).strip()[:300]
    return ProviderError(f"vlm={config.kind} ({config.model}): {status}: {said}", status)
