"""Whether films and pictures are whole: a browser shows a torn one as nothing."""

from __future__ import annotations

from pathlib import Path

from needlehoop.runs.reading import UnreadableError, read_bytes

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_HEADER = 8
"""Bytes of an MP4 box's length and name."""

_BOXES = 1_000
"""Of a film, at most; ours have four."""

_PICTURE = 64_000_000
"""Bytes of a picture, at most."""


def check_film(path: Path) -> None:
    """That an MP4 file's boxes fill it exactly, and that one of them is its index.

    Raises:
        UnreadableError: empty, cut off, or something else.
    """
    if not path.is_file():
        raise UnreadableError("is no plain file")
    size, at, found = path.stat().st_size, 0, []
    if not size:
        raise UnreadableError("is empty")
    with path.open("rb") as file:
        while at + _HEADER <= size and len(found) < _BOXES:
            file.seek(at)
            header = file.read(_HEADER)
            length = int.from_bytes(header[:4], "big")
            if length == 1:
                # Too long for four bytes: eight more hold it.
                length = int.from_bytes(file.read(8), "big")
            if length < _HEADER:
                break
            found.append(header[4:])
            at += length
    if at != size or b"moov" not in found:
        raise UnreadableError("is no film, or cut off")


def check_picture(path: Path) -> None:
    """That a PNG file begins and ends as one.

    Raises:
        UnreadableError: empty, cut off, something else, or not to be opened.
    """
    data = read_bytes(path, _PICTURE)
    if not data:
        raise UnreadableError("is empty")
    if not (data.startswith(_PNG_START) and data.endswith(_PNG_END)):
        raise UnreadableError("is no picture, or cut off")
