"""Whether films and pictures are whole: a browser shows a torn one as nothing."""

from __future__ import annotations

from pathlib import Path

from needlehoop.study.rows import UnreadableError

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_HEADER = 8
"""Bytes of an MP4 box's length and name."""


def check_film(path: Path) -> None:
    """That an MP4 file's boxes fill it exactly, and that one of them is its index.

    Raises:
        UnreadableError: empty, cut off, or something else.
    """
    size, at, found = path.stat().st_size, 0, set()
    if not size:
        raise UnreadableError("is empty")
    with path.open("rb") as file:
        while at + _HEADER <= size:
            file.seek(at)
            header = file.read(_HEADER)
            length = int.from_bytes(header[:4], "big")
            if length == 1:
                # Too long for four bytes: eight more hold it.
                length = int.from_bytes(file.read(8), "big")
            if length < _HEADER:
                break
            found.add(header[4:])
            at += length
    if at != size or b"moov" not in found:
        raise UnreadableError("is no film, or cut off")


def check_picture(path: Path) -> None:
    """That a PNG file begins and ends as one.

    Raises:
        UnreadableError: empty, cut off, something else, or not to be opened.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableError(f"can't be read: {error.strerror}") from error
    if not data:
        raise UnreadableError("is empty")
    if not (data.startswith(_PNG_START) and data.endswith(_PNG_END)):
        raise UnreadableError("is no picture, or cut off")
