"""What a program is compiled to: a straight line of torch calls over registers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor


class Step(NamedTuple):
    """``registers[out] = run(*(registers[i] for i in takes))``."""

    run: Callable[..., Tensor]
    takes: tuple[int, ...]
    out: int


@dataclass(frozen=True)
class Code:
    """A compiled program.

    ``registers`` holds the constants, and ``None`` where signals and results go; ``loads``
    are signals by name and their registers; ``terms`` are names, registers and whether the
    tensor there must be copied, because it is a signal's own or a constant.
    """

    registers: tuple[Tensor | None, ...]
    loads: tuple[tuple[str, int], ...]
    steps: tuple[Step, ...]
    terms: tuple[tuple[str, int, bool], ...]
