"""Pictures of a real bench, one a camera, from a folder."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image, ImageOps

from needlehoop.runs.reading import UnreadableError, read_bytes
from needlehoop.vlm.messages import Png

ABOUT = "about.txt"
"""The file beside the pictures that may say what the task is."""

_KINDS = (".png", ".jpg", ".jpeg")
_LARGEST = 64_000_000
"""Bytes of a picture, at most."""


def read_folder(folder: Path, about: str | None, size: int) -> tuple[dict[str, Png], str]:
    """The pictures by their files' names, no larger than ``size`` pixels, and what the task is.

    Args:
        folder: of the pictures.
        about: what the task is; ``None``: what ``about.txt`` says, if it is there.
        size: of the longer side.

    Raises:
        ValueError: no folder, fewer than two pictures, two of one name, or one that is damaged.
    """
    if not folder.is_dir():
        raise ValueError(f"pictures: {folder} is no folder")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in _KINDS)
    names = [file.stem for file in files]
    if len(names) < 2 or len(set(names)) < len(names):
        raise ValueError(
            f"pictures: {folder} must have two or more pictures ({', '.join(_KINDS)}) of different"
            f" names; it has: {', '.join(file.name for file in files) or 'none'}"
        )
    said = folder / ABOUT
    try:
        if about is None and said.exists():
            about = read_bytes(said).decode()
        pictures = {file.stem: _png(file, size) for file in files}
    except (UnreadableError, OSError, ValueError, Image.DecompressionBombError) as error:
        raise ValueError(f"pictures: {folder}: {error}") from error
    return pictures, (about or "").strip()


def _png(file: Path, size: int) -> Png:
    try:
        with Image.open(io.BytesIO(read_bytes(file, _LARGEST))) as opened:
            # A telephone notes which way is up, and where it was taken: the latter is left out.
            upright = ImageOps.exif_transpose(opened).convert("RGB")
    except (OSError, UnreadableError) as error:
        raise ValueError(f"{file.name}: no picture ({error})") from error
    upright.thumbnail((size, size))
    written = io.BytesIO()
    upright.save(written, "PNG")
    return Png(written.getvalue())
