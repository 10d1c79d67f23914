"""How large the cameras' images are: square, or as wide and as high as they are said to be."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import PlainValidator

from needlehoop.config.strict import Range, shown, structure

_Side = Annotated[int, Range(1, 2048)]


def _checked(value: Any) -> int | tuple[int, int]:
    if not isinstance(value, list | tuple):
        return structure(value, _Side)
    if len(value) != 2:
        raise ValueError(f"{shown(value)} is neither the side of a square nor [width, height]")
    width, height = (structure(side, _Side) for side in value)
    # The rasteriser counts columns from the middle.
    if (width - height) % 2:
        raise ValueError(f"{shown(value)}: width and height must differ by an even number")
    return _of(width, height)


ImageSize = Annotated[int | tuple[int, int], PlainValidator(_checked)]
"""Of images, px: the side of square ones, or width and height, which differ by an even number."""


def sides(size: ImageSize) -> tuple[int, int]:
    """Width and height, px."""
    return (size, size) if isinstance(size, int) else size


def extent(size: ImageSize) -> str:
    """In words: ``64`` or ``80 by 64``."""
    return " by ".join(map(str, dict.fromkeys(sides(size))))


def scaled_to(size: ImageSize, longer: int) -> ImageSize:
    """The size of images of the same shape whose longer side has ``longer`` px."""
    width, height = sides(size)
    # An even difference, as above.
    shorter = longer - 2 * round(longer * (1 - min(width, height) / max(width, height)) / 2)
    shorter = max(shorter, 2 - longer % 2)
    return _of(longer, shorter) if width > height else _of(shorter, longer)


def _of(width: int, height: int) -> ImageSize:
    return width if width == height else (width, height)
