"""Reward programs: a small part of Python over the signals, worked out with torch.

A person or a model writes a program as text. It assigns ``reward``. The text is never run as
Python: its tree is walked, and each node that the language has becomes a call of torch for all
environments at once. Both branches of an ``if`` are computed, and a ``where`` chooses for each
variable that they leave different.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from needlehoop.rewards.language.functions import (
    FUNCTIONS,
    JUNCTIONS,
    ProgramError,
    arithmetic,
    choose,
    compare,
    fit,
    foreign,
    kind_of,
    refuse,
    size_of,
)
from needlehoop.scene.signals import Signal, Signals, vocabulary

MAX_SOURCE = 10_000
"""Characters in a program."""
MAX_CONSTANT = 1e6
"""The largest number that may be written."""
MAX_DEPTH = 64
"""Operations and ifs inside each other."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

RESULT = "reward"


@dataclass(frozen=True)
class Program:
    """A checked program, which is a reward. Two programs are equal if their sources are.

    ``terms`` are the names that the last ``reward = a + b`` sums, or ``reward`` alone.
    """

    source: str
    terms: tuple[str, ...] = field(compare=False, repr=False)
    body: list[ast.stmt] = field(compare=False, repr=False)
    table: Mapping[str, Signal] = field(compare=False, repr=False)

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name. They may be infinite or NaN, as for ``log(0)``."""
        n = signals.batch_size[0]
        terms = _Walk(self.table, signals).terms(self.body)
        # Copies, because a term may be a signal itself.
        return {name: term.expand(n).clone() for name, term in terms.items()}


def compile_program(source: str, table: Mapping[str, Signal]) -> Program:
    """A program from its source; it may read all signals of the table but the verdicts.

    It is walked once with zeros. What is wrong with it shows there as a ``ProgramError``: no value
    changes which nodes are walked, nor the kinds of their results.
    """
    body = _parse(source).body
    zero = {
        name: torch.zeros(1, *row.shape, dtype=torch.bool if row.unit == "bool" else torch.float64)
        for name, row in table.items()
    }
    terms = _Walk(table, SimpleNamespace(**zero)).terms(body)
    return Program(source, tuple(terms), body, table)


def _parse(source: str) -> ast.Module:
    """A program's tree; ``ProgramError`` if it is too long, not ASCII, or not Python."""
    if len(source) > MAX_SOURCE:
        raise ProgramError(1, 1, f"{len(source)} characters; a program has at most {MAX_SOURCE}")
    for number, line in enumerate(source.split("\n"), 1):
        if not line.isascii():
            column = next(n for n, letter in enumerate(line) if not letter.isascii())
            raise ProgramError(number, column + 1, f"{line[column]!a} is not ASCII")
    try:
        return ast.parse(source)
    except SyntaxError as error:
        line, column = error.lineno or 1, max(1, error.offset or 1)
        raise ProgramError(line, column, f"not Python: {error.msg}") from error
    except (ValueError, MemoryError, RecursionError) as error:
        # A null character, or brackets and operators too deep inside each other.
        raise ProgramError(1, 1, f"not Python: {error or 'too deep'}") from error


def _literal(node: ast.expr) -> float | None:
    """A number that is written out, with its sign; ``None`` for anything else."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as value)):
            return -value
        case ast.Constant(value=int() | float() as value):
            return value
    return None


def _summed(node: ast.expr) -> list[str]:
    """The names that an expression sums; none if it is more than a plain sum."""
    match node:
        case ast.BinOp(left=ast.Name(id=first), op=ast.Add(), right=ast.Name(id=last)):
            return [first, last]
        case ast.BinOp(left=left, op=ast.Add(), right=ast.Name(id=last)) if names := _summed(left):
            return [*names, last]
    return []


class _Walk:
    """One walk over a program's tree; ``ProgramError`` for what is not in the language."""

    def __init__(self, table: Mapping[str, Signal], signals: Any):
        self._table, self._signals = table, signals
        self._variables: dict[str, Tensor] = {}
        self._summands: dict[str, Tensor] = {}
        """The values that the result sums, if it is a plain sum."""
        self._last: ast.stmt | None = None
        """The last assignment to the result."""
        self._depth = 0
        """How many operations and ifs are around what is walked."""

    def terms(self, body: list[ast.stmt]) -> dict[str, Tensor]:
        self._block(body)
        last = self._last
        if last is None or RESULT not in self._variables:
            line = (body[-1].end_lineno if body else None) or 1
            raise ProgramError(line, 1, f"{RESULT!r} is not assigned in every branch")
        terms = self._summands or {RESULT: self._variables[RESULT]}
        return {name: fit(value, last) for name, value in terms.items()}

    # Statements.

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)], value=expression):
                    value = self._value(expression)
                    self._assign(statement, name, value, self._terms_of(name, expression))
                case ast.AugAssign(target=ast.Name(id=name), op=op, value=expression):
                    old = self._name(statement, name)
                    changed = arithmetic(statement, op, old, self._value(expression))
                    self._assign(statement, name, changed, {})
                case ast.If():
                    self._if(statement)
                case _:
                    raise foreign(statement, statement)

    def _assign(
        self, statement: ast.stmt, name: str, value: Tensor, summands: dict[str, Tensor]
    ) -> None:
        if name in self._table or name in FUNCTIONS or name.startswith("_"):
            raise refuse(
                statement,
                f"{name!r}: a variable's name begins with a letter, and is no signal or function",
            )
        self._variables[name] = value
        if name == RESULT:
            self._last, self._summands = statement, summands

    def _terms_of(self, target: str, expression: ast.expr) -> dict[str, Tensor]:
        """The variables and signals that the result sums; none inside an ``if``."""
        names = _summed(expression)
        plain = target == RESULT and not self._depth and RESULT not in names
        if not plain or len(set(names)) < len(names):
            return {}
        return {name: self._name(expression, name) for name in names}

    def _if(self, statement: ast.If) -> None:
        condition = self._truth(statement.test)
        before, branches = self._variables, []
        self._deeper(statement)
        for body in (statement.body, statement.orelse):
            self._variables = dict(before)
            self._block(body)
            branches.append(self._variables)
        self._depth -= 1
        then, other = branches
        # A variable that only one branch assigns has no value afterwards.
        self._variables = {
            name: value
            if value is other[name]
            else choose(statement, condition, value, other[name])
            for name, value in then.items()
            if name in other
        }

    # Expressions.

    def _value(self, node: ast.expr) -> Tensor:
        self._deeper(node)
        found = self._expression(node)
        self._depth -= 1
        return found

    def _deeper(self, node: ast.AST) -> None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise refuse(node, f"more than {MAX_DEPTH} operations inside each other; split it up")

    def _expression(self, node: ast.expr) -> Tensor:
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                if value > MAX_CONSTANT:
                    raise refuse(node, f"numbers go up to {MAX_CONSTANT:g}")
                dtype = torch.bool if isinstance(value, bool) else torch.float64
                return torch.tensor([value], dtype=dtype, device=self._signals.elapsed.device)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return torch.logical_not(self._truth(operand))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
                value = self._value(operand)
                value = value if size_of(value) else fit(value, node)
                return torch.neg(value) if isinstance(sign, ast.USub) else value
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                base, exponent = fit(self._value(left), node), _literal(right)
                if exponent is None or abs(exponent) > MAX_EXPONENT:
                    raise refuse(
                        right, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
                    )
                return torch.pow(base, float(exponent))
            case ast.BinOp(left=left, op=op, right=right):
                return arithmetic(node, op, self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=operands):
                return reduce(JUNCTIONS[type(op)], map(self._truth, operands))
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                values = [fit(self._value(side), node) for side in (left, *comparators)]
                return compare(node, ops, values)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self._truth(test)
                return choose(node, condition, self._value(body), self._value(orelse))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._call(node, name, arguments)
            case ast.Call():
                raise refuse(node, "a call is a name and its arguments, without keywords")
            case _:
                raise foreign(node, node)

    def _name(self, node: ast.AST, name: str) -> Tensor:
        if name in self._variables:
            return self._variables[name]
        if name not in self._table:
            hint = f"; variables: {', '.join(self._variables)}" if self._variables else ""
            raise refuse(
                node, f"{name!r} is unknown; signals: {', '.join(vocabulary(self._table))}{hint}"
            )
        if self._table[name].source == "verdict":
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        return getattr(self._signals, name)

    def _truth(self, node: ast.expr) -> Tensor:
        value = self._value(node)
        if value.dtype != torch.bool:
            raise refuse(node, f"{kind_of(value)}, where a truth value such as a < b is needed")
        return value

    def _call(self, node: ast.Call, name: str, arguments: list[ast.expr]) -> Tensor:
        if name not in FUNCTIONS:
            raise refuse(node, f"{name!r} is no function; choose from {', '.join(FUNCTIONS)}")
        signature, _, takes, run = FUNCTIONS[name]
        more = len(arguments) - len(takes)
        if more < 0 or (more and "..." not in signature):
            raise refuse(node, f"{len(arguments)} arguments; {signature}")
        if name == "where":
            condition = self._truth(arguments[0])
            return choose(node, condition, self._value(arguments[1]), self._value(arguments[2]))
        if name == "component":
            vector, index = fit(self._value(arguments[0]), node, "vector"), _literal(arguments[1])
            if index is None or index not in range(size_of(vector)):
                raise refuse(node, f"an index is one of 0 to {size_of(vector) - 1}, written out")
            return vector[..., int(index)]
        values = [
            fit(self._value(argument), argument, wish)
            for argument, wish in zip(arguments, takes + takes[-1:] * more, strict=True)
        ]
        if set(takes) == {"vector"} and len({size_of(value) for value in values}) > 1:
            raise refuse(node, f"vectors of different lengths; {signature}")
        return run(*values)
