"""Settings of the vlm commands: who answers, where answers are kept, gates for reward programs."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from needlehoop.config.strict import Amount, OneOf, Positive, Range, Real, Seed, Share
from needlehoop.runs.files import check_folder, check_name
from needlehoop.runs.shipped import RECORDINGS

Samples = Annotated[int, Range(1, 10_000)]
"""How many conversations, each of which begins afresh."""

Weight = Annotated[str, OneOf("flag", "refuse")]
"""What failing a gate does to a program."""


@dataclass(frozen=True)
class InquiryConfig:
    """Values in ``conf/ask.yaml``, which explains them."""

    results: str
    study: str
    size: Annotated[int, Range(16, 4096)]
    attempts: Annotated[int, Range(1, 1000)]
    overwrite: bool

    def __post_init__(self) -> None:
        check_folder("results", self.results)
        check_name("study", self.study)

    @property
    def folder(self) -> Path:
        return Path(self.results) / self.study / "vlm"


@dataclass(frozen=True)
class Gates:
    """Tests of a reward program before training on it; ``conf/gates`` explains the values.

    A program that fails a gate is refused. The cheat audit and stopping short only flag it, unless
    ``audit`` or ``stop`` is ``refuse``, because most honest rewards cannot tell a good cheat.
    """

    random_signals: Annotated[int, Range(1, 10_000_000)]
    episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of each controller."""
    seed: Seed
    low: Real
    high: Real
    bonus: Amount
    range: Annotated[str, OneOf("refuse", "clip")]
    tolerance: Amount
    margin: Real
    audit: Weight
    audit_margin: Real
    stop: Weight
    stop_margin: Real
    stop_episodes: Annotated[int, Range(1, 100_000)]
    """Episodes of the teacher stopped short, for each way of doing so."""
    random_episodes: Annotated[int, Range(1, 100_000)]
    paid_by: Positive
    paid: Share

    def __post_init__(self) -> None:
        if not self.low < self.top:
            raise ValueError(f"gates.low: {self.low} must be below high + bonus = {self.top}")

    @property
    def top(self) -> float:
        return self.high + self.bonus


TRANSCRIPT = "transcript.jsonl"


def transcripts() -> dict[str, Path]:
    """The shipped recordings that can be replayed, by name."""
    return {file.parent.name: file.parent for file in sorted(RECORDINGS.glob(f"*/{TRANSCRIPT}"))}


PromptDetail = Annotated[str, OneOf("full", "names", "nothing")]
"""How much prompts tell of the task when a model ranks cameras or writes a reward."""


@dataclass(frozen=True)
class ReplayConfig:
    """Values in ``conf/vlm/replay.yaml``, which explains them."""

    kind: str
    recording: str | None
    prompt_detail: PromptDetail = "full"

    def folder(self, study: Path) -> Path:
        """The folder of the answers; ``study`` is the study's own."""
        shipped = transcripts()
        if self.recording is None:
            return study if (study / TRANSCRIPT).exists() else shipped["claude"]
        return shipped.get(self.recording, Path(self.recording))


@dataclass(frozen=True)
class LiveConfig:
    """Values in ``conf/vlm/gemini.yaml``, which explains them, and ``openai.yaml``."""

    kind: str
    model: str
    key: str | None
    """Environment variable that holds the key; ``None`` for servers without keys."""
    base_url: str | None
    """The server's address; ``None`` is the provider's own."""
    sampling: Mapping[str, Any]
    timeout: Annotated[float, Range(0.0, 86_400.0, above=True)]
    """Seconds."""
    tries: Annotated[int, Range(1, 1000)]
    prompt_detail: PromptDetail = "full"

    def __post_init__(self) -> None:
        if self.key is not None and not re.fullmatch(r"[A-Z][A-Z0-9_]{1,60}", self.key):
            # The value is not shown: it may be the key itself.
            raise ValueError(
                "vlm.key: give the name of an environment variable, such as GEMINI_API_KEY"
            )

    @property
    def sent(self) -> dict[str, Any]:
        return {name: value for name, value in self.sampling.items() if value is not None}

    def read_key(self) -> str | None:
        """The key; ``ValueError`` if its variable is not set."""
        value = self.key and os.environ.get(self.key, "").strip()
        if value == "":
            raise ValueError(
                f"vlm.key: the environment variable {self.key} is not set; set it to your key,"
                " or replay a recording with vlm=replay"
            )
        return value


@dataclass(frozen=True)
class ManualConfig:
    """Values in ``conf/vlm/manual.yaml``, which explains them; times in s."""

    kind: str
    model: str
    wait: Annotated[float, Range(0.0, 1e9)] | None
    poll: Annotated[float, Range(0.0, 86_400.0, above=True)]
    prompt_detail: PromptDetail = "full"


VlmConfig = ReplayConfig | LiveConfig | ManualConfig

KINDS: dict[str, type[VlmConfig]] = {
    "replay": ReplayConfig,
    "gemini": LiveConfig,
    "openai": LiveConfig,
    "manual": ManualConfig,
}
"""Who answers, by ``vlm.kind``."""
