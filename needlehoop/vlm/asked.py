"""What an inquiry is told: where it is kept, and how persistently it asks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from needlehoop.config.strict import Range
from needlehoop.runs.files import check_folder, check_name

Samples = Annotated[int, Range(1, 10_000)]
"""Conversations that each begin afresh."""


@dataclass(frozen=True)
class InquiryConfig:
    """Values in ``conf/ask.yaml``."""

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
        """Where results are written."""
        return Path(self.results) / self.study / "vlm"
