"""Reward programs: a small part of Python over the signals, compiled to torch.

A person or a model writes a program as text. It assigns ``reward``. The text is never run as
Python.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torch import Tensor

from needlehoop.rewards.language.compiler import Code, Compiler
from needlehoop.rewards.language.grammar import parse

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signal, Signals


@dataclass(frozen=True)
class Program:
    """A compiled program, which is a reward. Two programs are equal if their sources are."""

    source: str
    code: Code = field(compare=False, repr=False)

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms' names: those that the last ``reward = a + b`` sums, else ``reward``."""
        return tuple(name for name, _, _ in self.code.terms)

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name. They may be infinite or NaN, as for ``log(0)``."""
        registers = list(self.code.registers)
        for name, register in self.code.loads:
            registers[register] = getattr(signals, name)
        for run, takes, out in self.code.steps:
            registers[out] = run(*[registers[i] for i in takes])
        n = signals.batch_size[0]
        terms = {}
        for name, register, shared in self.code.terms:
            value = registers[register]
            assert value is not None
            terms[name] = value.expand(n).clone() if shared else value
        return terms


def compile_program(source: str, table: Mapping[str, Signal]) -> Program:
    """A program from its source.

    Args:
        source: its text.
        table: of the signals; it may read all but the verdicts.

    Raises:
        ProgramError: the program is refused; ``line``, ``column`` and ``reason`` say why.
    """
    return Program(source, Compiler(table).compile(parse(source)))
