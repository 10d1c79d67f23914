"""The record of everything that was asked and answered: one JSON line per exchange."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from needlehoop.runs.files import naming, write_whole
from needlehoop.runs.reading import RECORD, UnreadableError, read_bytes
from needlehoop.runs.run import Run
from needlehoop.vlm.messages import PICTURE, Canonical, Png, Request, mistakes

TRANSCRIPT, IMAGES = "transcript.jsonl", "images"


@dataclass(frozen=True)
class Exchange:
    """One request and its reply; ``outcome`` and ``detail`` are as in ``Reply``.

    ``attempts`` are the HTTP statuses of all tries. ``seconds`` is the time of all tries, ``time``
    the start of the first (UTC).
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True)

    sha256: str
    """The hash of the canonical request."""
    conversation: str
    """``question``, ``rank``, ``rank/2``, ``reward/text`` or ``reward/<cameras>/image``."""
    request: Canonical
    provider: str
    model: str
    """The model asked for."""
    sampling: dict[str, Any]
    outcome: str
    answer: str
    detail: str
    answered_by: str | None
    tokens_in: int | None
    tokens_out: int | None
    attempts: tuple[int | str, ...]
    seconds: float
    time: str

    @property
    def usable(self) -> bool:
        """Whether the model gave an answer that a conversation can go on from."""
        return self.outcome in ("answered", "truncated")

    @property
    def asked(self) -> dict[str, Any]:
        """Who was asked and how, as in ``LiveConfig.asked``."""
        return {"provider": self.provider, "model": self.model, "sampling": self.sampling}


class Transcript:
    """The transcript in a folder, with the pictures that were shown beside it.

    Args:
        folder: of ``transcript.jsonl`` and ``images/``. It is made at the first writing.

    Raises:
        ValueError: a line is not an exchange.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.path = folder / TRANSCRIPT
        self.torn: str | None = None
        """What to say of a last line that is cut off and left out; ``None`` if there is none."""
        self.exchanges: list[Exchange] = list(self._read())

    def add(self, exchange: Exchange, request: Request) -> None:
        """Append an exchange, and save its new pictures."""
        for picture in request.pictures:
            self.save(picture)
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.torn is not None:
            os.truncate(self.path, self._bytes().rfind(b"\n") + 1)
            self.torn = None
        with naming(self.path), self.path.open("a", encoding="utf-8") as file:
            file.write(_line(exchange))
            file.flush()
            os.fsync(file.fileno())
        self.exchanges.append(exchange)

    def save(self, picture: Png) -> None:
        """Keep a picture as ``images/<hash>.png``, once."""
        path = self.folder / IMAGES / f"{picture.sha256}.png"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, picture.png)

    def picture(self, sha256: str) -> Png:
        """A saved picture.

        Raises:
            ValueError: it is not there, or its content does not have that hash.
        """
        path = self.folder / IMAGES / f"{sha256}.png"
        if not path.is_file():
            raise ValueError(f"{path}: missing; it belongs to the record")
        try:
            picture = Png(read_bytes(path, PICTURE))
        except UnreadableError as error:
            raise ValueError(f"{path} {error}") from error
        if picture.sha256 != sha256:
            raise ValueError(f"{path}: its content is not what its name says")
        return picture

    def retire(self, chosen: Callable[[str], bool]) -> None:
        """Remove conversations by their names. The file as it was is kept under a number."""
        kept = [exchange for exchange in self.exchanges if not chosen(exchange.conversation)]
        if len(kept) < len(self.exchanges):
            Run(self.folder).write(TRANSCRIPT, "".join(map(_line, kept)))
            self.exchanges, self.torn = kept, None

    def _read(self) -> Iterator[Exchange]:
        if not self.path.exists():
            return
        # Split as bytes: the file may be cut off inside a character.
        *lines, rest = self._bytes().split(b"\n")
        for number, line in enumerate(lines, 1):
            try:
                exchange = _EXCHANGE.validate_json(line)
            except ValidationError as error:
                said = "; ".join(mistakes(error))
                raise ValueError(f"{self.path}: line {number} is no exchange: {said}") from error
            yield exchange
        if rest:
            self.torn = f"{self.path}: line {len(lines) + 1} is cut off and left out"

    def _bytes(self) -> bytes:
        try:
            return read_bytes(self.path, RECORD)
        except UnreadableError as error:
            raise ValueError(f"{self.path} {error}") from error


_EXCHANGE = TypeAdapter(Exchange)


def _line(exchange: Exchange) -> str:
    return json.dumps(asdict(exchange), ensure_ascii=False) + "\n"
