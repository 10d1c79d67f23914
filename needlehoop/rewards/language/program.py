"""Reward programs: a small part of Python over the signals, compiled to torch.

A person or a model writes a program as text. It assigns ``reward``. The text is never run as
Python: its tree is walked once, and every expression becomes a step that writes one register. An
``if`` becomes the steps of both branches, and a ``where`` for each variable they leave different.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from torch import Tensor

from needlehoop.rewards.language.expressions import Expressions, Partial, Variables
from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.rewards.language.grammar import ProgramError, foreign, parse, refuse, summed
from needlehoop.rewards.language.tape import Code, Register, Tape

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signal, Signals

MAX_STATEMENTS = 100
"""Statements in a program, those inside ifs included."""
MAX_NESTING = 16
"""Ifs inside each other, ``elif`` included."""

RESULT = "reward"
"""The variable that holds a program's value."""


@dataclass(frozen=True)
class Program:
    """A compiled program, which is a reward. ``compile_program`` makes it.

    Two programs are equal if their sources are.
    """

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
    return Program(source, _Compiler(table).compile(parse(source)))


class _Compiler:
    """Writes the statements of one program."""

    def __init__(self, table: Mapping[str, Signal]):
        self._tape, self._signals = Tape(), table
        self._expressions = Expressions(self._tape, table)
        self._statements = self._nesting = 0
        self._last: tuple[ast.stmt, dict[str, Register]] | None = None
        """The last assignment to the result, and the terms it is the sum of."""

    def compile(self, tree: ast.Module) -> Code:
        self._block(tree.body)
        found = self._expressions.variables.get(RESULT)
        if not isinstance(found, Register):
            end = tree.body[-1].end_lineno if tree.body else None
            some = " in only one branch of an if" if isinstance(found, Partial) else " nowhere"
            raise ProgramError(
                end or 1, 1, f"{RESULT!r} is assigned{some}; a program's value is that variable"
            )
        assert self._last is not None
        last, terms = self._last
        terms = terms or {RESULT: found}
        return self._tape.code({n: self._tape.number(r, last, n) for n, r in terms.items()})

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statements += 1
            if self._statements > MAX_STATEMENTS:
                raise refuse(statement, f"a program has at most {MAX_STATEMENTS} statements")
            match statement:
                case ast.Assign(targets=[ast.Name() as target], value=expression):
                    value = self._expressions.value(expression)
                    self._assign(statement, target, value, self._terms(target, expression))
                case ast.Assign():
                    raise refuse(statement, "an assignment has one name on its left")
                case ast.AugAssign(target=ast.Name() as target, op=op, value=expression):
                    old = self._expressions.name(target, target.id)
                    by = self._expressions.value(expression)
                    changed = self._expressions.arithmetic(statement, op, old, by)
                    self._assign(statement, target, changed, {})
                case ast.If():
                    self._if(statement)
                case _:
                    raise foreign(statement)

    def _assign(
        self, statement: ast.stmt, target: ast.Name, value: Register, terms: dict[str, Register]
    ) -> None:
        for table, what in ((self._signals, "signal"), (FUNCTIONS, "function")):
            if target.id in table:
                raise refuse(target, f"{target.id!r} is a {what}; choose another name")
        self._expressions.variables[target.id] = value
        if target.id == RESULT:
            self._last = statement, terms

    def _terms(self, target: ast.Name, expression: ast.expr) -> dict[str, Register]:
        """The variables and signals that the result is the plain sum of, outside every if."""
        names = summed(expression)
        plain = target.id == RESULT and not self._nesting and RESULT not in names
        if not plain or len(set(names)) < len(names):
            return {}
        return {name: self._expressions.name(expression, name) for name in names}

    def _if(self, statement: ast.If) -> None:
        condition = self._expressions.condition(statement.test)
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise refuse(statement, f"more than {MAX_NESTING} ifs inside each other")
        before = self._expressions.variables
        branches: list[Variables] = []
        for body in (statement.body, statement.orelse):
            self._expressions.variables = dict(before)
            self._block(body)
            branches.append(self._expressions.variables)
        self._nesting -= 1
        then, other = branches
        self._expressions.variables = {
            name: self._merged(statement, name, condition, then.get(name), other.get(name))
            for name in {**then, **other}
        }

    def _merged(
        self,
        statement: ast.If,
        name: str,
        condition: Register,
        then: Register | Partial | None,
        other: Register | Partial | None,
    ) -> Register | Partial:
        """A variable after an if, from its values at the end of the two branches."""
        if isinstance(then, Register) and isinstance(other, Register):
            if then == other:
                return then
            what = f"{name!r} after the if"
            return self._tape.choose(statement, what, condition, then, other)
        if isinstance(then, Partial):
            return then
        return other if isinstance(other, Partial) else Partial(statement.lineno)
