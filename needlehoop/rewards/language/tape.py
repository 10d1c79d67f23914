"""The compiled form of a program, and the tape on which it is written.

A compiled program is a straight line of torch calls over numbered registers.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.rewards.language.functions import NUMBER, TRUTH, Kind, choose_vector
from needlehoop.rewards.language.grammar import refuse


class Step(NamedTuple):
    """``registers[out] = run(*(registers[i] for i in takes))``."""

    run: Callable[..., Tensor]
    takes: tuple[int, ...]
    out: int


@dataclass(frozen=True)
class Code:
    """A compiled program.

    Args:
        registers: the constants; ``None`` where a signal or a result goes.
        loads: each signal's name and its register.
        steps: the calls, in order.
        terms: each term's name, its register, and whether that tensor must be copied. It must
            be where it belongs to a signal or is a constant.
    """

    registers: tuple[Tensor | None, ...]
    loads: tuple[tuple[str, int], ...]
    steps: tuple[Step, ...]
    terms: tuple[tuple[str, int, bool], ...]


class Register(NamedTuple):
    """The number of a register, and the kind of its value."""

    index: int
    kind: Kind


class Tape:
    """Writes steps. The same call on the same registers is written once."""

    def __init__(self):
        self._registers: list[Tensor | None] = []
        self._loads: dict[str, Register] = {}
        self._steps: list[Step] = []
        self._known: dict[object, Register] = {}
        """Results by what they are computed from."""

    def constant(self, value: bool | float) -> Register:
        """A number or a truth value that is written out."""
        key = (type(value), value)
        if key not in self._known:
            truth = isinstance(value, bool)
            tensor = torch.tensor(value, dtype=torch.bool if truth else torch.float64)
            self._known[key] = Register(self._new(tensor), TRUTH if truth else NUMBER)
        return self._known[key]

    def signal(self, name: str, kind: Kind) -> Register:
        """A signal, loaded once."""
        if name not in self._loads:
            self._loads[name] = Register(self._new(None), kind)
        return self._loads[name]

    def emit(
        self, key: object, run: Callable[..., Tensor], takes: list[Register], kind: Kind = TRUTH
    ) -> Register:
        """The result of a call. A call on constants alone is computed at once.

        Args:
            key: tells this call from other calls on the same registers.
            run: a pure function of tensors.
            takes: its arguments.
            kind: its result's.
        """
        indices = tuple(register.index for register in takes)
        known = (key, indices)
        if known not in self._known:
            constants = [self._registers[index] for index in indices]
            if any(constant is None for constant in constants):
                out = self._new(None)
                self._steps.append(Step(run, indices, out))
            else:
                out = self._new(run(*constants))
            self._known[known] = Register(out, kind)
        return self._known[known]

    def number(self, register: Register, node: ast.AST, what: str) -> Register:
        """A number as it is; a truth value as 0 or 1.

        Raises:
            ProgramError: a vector, where ``what`` takes a number.
        """
        if register.kind.size:
            raise refuse(node, f"{register.kind}, where {what} takes a number")
        if register.kind == NUMBER:
            return register
        return self.emit("number", Tensor.double, [register], NUMBER)

    def truth(self, register: Register, node: ast.AST, what: str) -> Register:
        """A truth value as it is.

        Raises:
            ProgramError: anything else, where ``what`` takes a truth value.
        """
        if register.kind != TRUTH:
            raise refuse(node, f"{register.kind}, where {what} takes a truth value, such as a < b")
        return register

    def choose(
        self, node: ast.AST, what: str, condition: Register, a: Register, b: Register
    ) -> Register:
        """``a`` in the environments where the condition holds, else ``b``.

        Raises:
            ProgramError: a vector and something that is not a vector of its length.
        """
        if a.kind != b.kind:
            if a.kind.size or b.kind.size:
                raise refuse(node, f"{what} is {a.kind} or {b.kind}; it must be of one kind")
            a, b = self.number(a, node, what), self.number(b, node, what)
        run = choose_vector if a.kind.size else torch.where
        return self.emit("where", run, [condition, a, b], a.kind)

    def code(self, terms: Mapping[str, Register]) -> Code:
        """The steps that some term needs."""
        needed = {register.index for register in terms.values()}
        steps = []
        for step in reversed(self._steps):
            if step.out in needed:
                needed.update(step.takes)
                steps.append(step)
        made = {step.out for step in steps}
        loads = [(n, r.index) for n, r in self._loads.items() if r.index in needed]
        return Code(
            registers=tuple(self._registers),
            loads=tuple(loads),
            steps=tuple(reversed(steps)),
            terms=tuple((n, r.index, r.index not in made) for n, r in terms.items()),
        )

    def _new(self, tensor: Tensor | None) -> int:
        self._registers.append(tensor)
        return len(self._registers) - 1
