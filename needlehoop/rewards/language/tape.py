"""The code of a program while it is being written."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.rewards.language.code import Code, Step
from needlehoop.rewards.language.functions import NUMBER, TRUTH, Kind, choose_vector
from needlehoop.rewards.language.tree import refuse


class Value(NamedTuple):
    """A register and what is in it."""

    register: int
    kind: Kind


class Tape:
    """Registers, and the steps that fill them; nothing is computed twice."""

    def __init__(self):
        self._registers: list[Tensor | None] = []
        self._loads: dict[str, Value] = {}
        self._steps: list[Step] = []
        self._known: dict[object, Value] = {}
        """Results by what they are computed from."""

    def constant(self, value: bool | float) -> Value:
        """A number or a truth value that is written out."""
        key = (type(value), value)
        if key not in self._known:
            truth = isinstance(value, bool)
            tensor = torch.tensor(value, dtype=torch.bool if truth else torch.float64)
            self._known[key] = Value(self._register(tensor), TRUTH if truth else NUMBER)
        return self._known[key]

    def signal(self, name: str, kind: Kind) -> Value:
        """A signal, loaded once."""
        if name not in self._loads:
            self._loads[name] = Value(self._register(None), kind)
        return self._loads[name]

    def emit(
        self, key: object, run: Callable[..., Tensor], takes: list[Value], kind: Kind = TRUTH
    ) -> Value:
        """The result of a call; of constants, computed here and now.

        Args:
            key: tells the call from others of the same arguments.
            run: a pure function of tensors.
            takes: its arguments.
            kind: its result's.
        """
        registers = tuple(value.register for value in takes)
        known = (key, registers)
        if known not in self._known:
            constants = [self._registers[register] for register in registers]
            if any(constant is None for constant in constants):
                out = self._register(None)
                self._steps.append(Step(run, registers, out))
            else:
                out = self._register(run(*constants))
            self._known[known] = Value(out, kind)
        return self._known[known]

    def number(self, value: Value, node: ast.AST, what: str) -> Value:
        """A number as it is, a truth value as 0 or 1.

        Raises:
            ProgramError: a vector; ``what`` takes a number.
        """
        if value.kind.size:
            raise refuse(node, f"{value.kind}, where {what} takes a number")
        if value.kind == NUMBER:
            return value
        return self.emit("number", Tensor.double, [value], NUMBER)

    def truth(self, value: Value, node: ast.AST, what: str) -> Value:
        """A truth value as it is.

        Raises:
            ProgramError: anything else; ``what`` takes a truth value.
        """
        if value.kind != TRUTH:
            raise refuse(node, f"{value.kind}, where {what} takes a truth value, such as a < b")
        return value

    def choose(self, node: ast.AST, what: str, condition: Value, a: Value, b: Value) -> Value:
        """``a`` where the condition holds, else ``b``, environment by environment.

        Raises:
            ProgramError: a vector and something that is none of its length.
        """
        if a.kind != b.kind:
            if a.kind.size or b.kind.size:
                raise refuse(node, f"{what} is {a.kind} or {b.kind}; it must be of one kind")
            a, b = self.number(a, node, what), self.number(b, node, what)
        run = choose_vector if a.kind.size else torch.where
        return self.emit("where", run, [condition, a, b], a.kind)

    def code(self, terms: Mapping[str, Value]) -> Code:
        """What was written, without what no term needs."""
        needed = {value.register for value in terms.values()}
        steps = []
        for step in reversed(self._steps):
            if step.out in needed:
                needed.update(step.takes)
                steps.append(step)
        made = {step.out for step in steps}
        loads = [(n, v.register) for n, v in self._loads.items() if v.register in needed]
        return Code(
            registers=tuple(self._registers),
            loads=tuple(loads),
            steps=tuple(reversed(steps)),
            terms=tuple((n, v.register, v.register not in made) for n, v in terms.items()),
        )

    def _register(self, tensor: Tensor | None) -> int:
        self._registers.append(tensor)
        return len(self._registers) - 1
