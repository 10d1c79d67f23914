"""Reward programs: a small part of Python over the signals, compiled to torch calls.

A person or a model writes a program as text. It assigns ``reward``. The text is never run as
Python: its tree is walked once, and each operation becomes a call of torch. Both branches of an
``if`` are computed, and a ``where`` chooses for each variable that they leave different.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial, reduce
from operator import attrgetter, itemgetter
from types import SimpleNamespace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from needlehoop.rewards.language.functions import ARITHMETIC, COMPARISONS, FUNCTIONS, JUNCTIONS
from needlehoop.rewards.language.grammar import (
    MAX_CONSTANT,
    ProgramError,
    foreign,
    literal,
    parse,
    refuse,
    summed,
)
from needlehoop.scene.signals import Signal, Signals, vocabulary

MAX_NODES = 2000
"""Names, numbers and operations in a program."""
MAX_DEPTH = 64
"""Operations inside each other in one expression."""
MAX_STATEMENTS = 100
"""Statements in a program, those inside ifs included."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

RESULT = "reward"
"""The variable that holds a program's value."""

Step = tuple[Callable[..., Any], tuple[int, ...]]
"""A call, and what it takes: the signals are number 0, results of earlier steps count from 1."""


@dataclass(frozen=True)
class Program:
    """A compiled program, which is a reward. Two programs are equal if their sources are.

    ``results`` has the number of each term's step. The terms are the names that the last
    ``reward = a + b`` sums, or ``reward`` alone.
    """

    source: str
    steps: tuple[Step, ...] = field(compare=False, repr=False)
    results: Mapping[str, int] = field(compare=False, repr=False)

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms' names."""
        return tuple(self.results)

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name. They may be infinite or NaN, as for ``log(0)``."""
        found: list[Any] = [signals]
        for run, takes in self.steps:
            found.append(run(*[found[number] for number in takes]))
        n = signals.batch_size[0]
        # Copies, because a term may be a signal itself.
        return {name: found[number].expand(n).clone() for name, number in self.results.items()}


def compile_program(source: str, table: Mapping[str, Signal]) -> Program:
    """A program from its source; it may read all signals of the table but the verdicts.

    Raises:
        ProgramError: the program is refused; ``line``, ``column`` and ``reason`` say why.
    """
    return _Compiler(table).program(source)


class _Value(NamedTuple):
    """The number of a step, and what it gives where every signal is zero.

    That tensor shows the kind: ``(n,)`` bool is a truth value, ``(n,)`` float64 a number, and
    ``(n, k)`` float64 a k-vector. ``n`` is 1 here.
    """

    number: int
    like: Any

    @property
    def size(self) -> int:
        """The length of a vector; 0 for a number or a truth value."""
        return self.like.shape[1] if self.like.ndim == 2 else 0

    @property
    def kind(self) -> str:
        if self.size:
            return f"a {self.size}-vector"
        return "a truth value" if self.like.dtype == torch.bool else "a number"


class _Compiler:
    """Compiles one program. Its methods raise ``ProgramError`` for what is not in the language."""

    def __init__(self, table: Mapping[str, Signal]):
        self._table = table
        zero = {
            name: torch.zeros(1, *s.shape, dtype=torch.bool if s.unit == "bool" else torch.float64)
            for name, s in table.items()
        }
        self._signals, self._steps = _Value(0, SimpleNamespace(**zero)), []
        self._variables: dict[str, _Value] = {}
        self._summands: dict[str, _Value] = {}
        """The values whose plain sum the result is, if it is one."""
        self._last: ast.stmt | None = None
        """The last assignment to the result."""
        self._nodes = self._depth = self._statements = self._ifs = 0

    def program(self, source: str) -> Program:
        """The whole program."""
        body = parse(source).body
        self._block(body)
        last = self._last
        if last is None or RESULT not in self._variables:
            line = (body[-1].end_lineno if body else None) or 1
            raise ProgramError(line, 1, f"{RESULT!r} is not assigned in every branch")
        terms = self._summands or {RESULT: self._variables[RESULT]}
        results = {name: self._number(one, last).number for name, one in terms.items()}
        return Program(source, tuple(self._steps), results)

    def _do(self, run: Callable[..., Any], *takes: _Value) -> _Value:
        """The result of one more step."""
        self._steps.append((run, tuple(one.number for one in takes)))
        return _Value(len(self._steps), run(*(one.like for one in takes)))

    # Statements.

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statements += 1
            if self._statements > MAX_STATEMENTS:
                raise refuse(statement, f"a program has at most {MAX_STATEMENTS} statements")
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)], value=expression):
                    value = self._value(expression)
                    self._assign(statement, name, value, self._summed(name, expression))
                case ast.AugAssign(target=ast.Name(id=name), op=op, value=expression):
                    old = self._name(statement, name)
                    changed = self._arithmetic(statement, op, old, self._value(expression))
                    self._assign(statement, name, changed, {})
                case ast.If():
                    self._if(statement)
                case _:
                    raise foreign(statement)

    def _assign(
        self, statement: ast.stmt, name: str, value: _Value, summands: dict[str, _Value]
    ) -> None:
        if name in self._table or name in FUNCTIONS or name.startswith("_"):
            raise refuse(
                statement,
                f"{name!r}: a variable's name begins with a letter, and is no signal or function",
            )
        self._variables[name] = value
        if name == RESULT:
            self._last, self._summands = statement, summands

    def _summed(self, target: str, expression: ast.expr) -> dict[str, _Value]:
        """The variables and signals that the result is the plain sum of, outside every if."""
        names = summed(expression)
        plain = target == RESULT and not self._ifs and RESULT not in names
        if not plain or len(set(names)) < len(names):
            return {}
        return {name: self._name(expression, name) for name in names}

    def _if(self, statement: ast.If) -> None:
        condition = self._truth(statement.test)
        before, branches = self._variables, []
        self._ifs += 1
        for body in (statement.body, statement.orelse):
            self._variables = dict(before)
            self._block(body)
            branches.append(self._variables)
        self._ifs -= 1
        then, other = branches
        # A variable that only one branch assigns has no value afterwards.
        self._variables = {
            name: value
            if value is other[name]
            else self._choose(statement, condition, value, other[name])
            for name, value in then.items()
            if name in other
        }

    # Expressions.

    def _value(self, node: ast.expr) -> _Value:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise refuse(node, f"a program has at most {MAX_NODES} names, numbers and operations")
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise refuse(node, f"more than {MAX_DEPTH} operations inside each other; split it up")
        found = self._expression(node)
        self._depth -= 1
        return found

    def _expression(self, node: ast.expr) -> _Value:
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                if value > MAX_CONSTANT:
                    raise refuse(node, f"numbers go up to {MAX_CONSTANT:g}")
                dtype = torch.bool if isinstance(value, bool) else torch.float64
                tensor = torch.tensor([value], dtype=dtype)
                return self._do(lambda: tensor)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self._do(torch.logical_not, self._truth(operand))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
                value = self._value(operand)
                value = value if value.size else self._number(value, node)
                return self._do(torch.neg, value) if isinstance(sign, ast.USub) else value
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                base, exponent = self._value(left), literal(right)
                if exponent is None or abs(exponent) > MAX_EXPONENT:
                    raise refuse(
                        right, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
                    )
                power = partial(torch.pow, exponent=float(exponent))
                return self._do(power, self._number(base, node))
            case ast.BinOp(left=left, op=op, right=right):
                return self._arithmetic(node, op, self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=operands):
                return reduce(partial(self._do, JUNCTIONS[type(op)]), map(self._truth, operands))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compare(node, ops, [self._value(one) for one in (left, *others)])
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self._truth(test)
                return self._choose(node, condition, self._value(body), self._value(orelse))
            case ast.Call(func=ast.Name(id=name), args=given, keywords=[]):
                return self._call(node, name, given)
            case ast.Call():
                raise refuse(
                    node, "a call is a function's name and its arguments, without keywords"
                )
            case _:
                raise foreign(node)

    def _name(self, node: ast.AST, name: str) -> _Value:
        """The value of a variable or a signal."""
        if name in self._variables:
            return self._variables[name]
        if name not in self._table:
            own = f"; variables: {', '.join(self._variables)}" if self._variables else ""
            raise refuse(
                node, f"{name!r} is unknown; signals: {', '.join(vocabulary(self._table))}{own}"
            )
        if self._table[name].source == "verdict":
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        return self._do(attrgetter(name), self._signals)

    def _truth(self, node: ast.expr) -> _Value:
        value = self._value(node)
        if value.kind != "a truth value":
            raise refuse(node, f"{value.kind}, where a truth value such as a < b is needed")
        return value

    def _compare(self, node: ast.Compare, ops: list[ast.cmpop], values: list[_Value]) -> _Value:
        """``a < b < c`` is ``a < b and b < c``."""
        found = []
        for op, *pair in zip(ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS:
                raise refuse(node, f"{type(op).__name__} is not in the language")
            numbers = [self._number(value, node) for value in pair]
            found.append(self._do(COMPARISONS[type(op)], *numbers))
        return reduce(partial(self._do, torch.logical_and), found)

    def _call(self, node: ast.Call, name: str, given: list[ast.expr]) -> _Value:
        if name not in FUNCTIONS:
            raise refuse(node, f"{name!r} is no function; choose from {', '.join(FUNCTIONS)}")
        signature, _, takes, run = FUNCTIONS[name]
        more = len(given) - len(takes)
        if more < 0 or (more and "..." not in signature):
            raise refuse(node, f"{len(given)} arguments; {signature}")
        if name == "component":
            return self._component(given[0], given[1])
        if name == "where":
            condition, a, b = self._truth(given[0]), self._value(given[1]), self._value(given[2])
            return self._choose(node, condition, a, b)
        values = [
            self._fit(self._value(argument), wish, argument)
            for argument, wish in zip(given, takes + takes[-1:] * more, strict=True)
        ]
        if set(takes) == {"vector"} and len({value.size for value in values}) > 1:
            raise refuse(node, f"vectors of different lengths; {signature}")
        return self._do(run, *values)

    def _component(self, vector: ast.expr, index: ast.expr) -> _Value:
        value, number = self._fit(self._value(vector), "vector", vector), literal(index)
        if number is None or number not in range(value.size):
            raise refuse(index, f"the index is one of 0 to {value.size - 1}, written out")
        return self._do(itemgetter((..., int(number))), value)

    # Operations.

    def _number(self, value: _Value, node: ast.AST) -> _Value:
        """A number as it is; a truth value as 0 or 1. A vector is refused."""
        return self._fit(value, "number", node)

    def _fit(self, value: _Value, wish: str, node: ast.AST) -> _Value:
        """A value as an argument: ``number``, ``vector``, ``vector3`` or ``vector4``."""
        if wish == "number" and not value.size:
            return self._do(Tensor.double, value) if value.like.dtype == torch.bool else value
        if value.size and wish in ("vector", f"vector{value.size}"):
            return value
        raise refuse(node, f"{value.kind}, where a {wish} is needed")

    def _arithmetic(self, node: ast.AST, op: ast.operator, a: _Value, b: _Value) -> _Value:
        if type(op) not in ARITHMETIC:
            raise refuse(node, f"{type(op).__name__} is not in the language")
        run = ARITHMETIC[type(op)]
        if not a.size and not b.size:
            return self._do(run, self._number(a, node), self._number(b, node))
        if a.size == b.size and run in (torch.add, torch.sub):
            return self._do(run, a, b)
        if run is torch.mul and not a.size:
            a, b = b, a
        if run in (torch.mul, torch.div) and not b.size:
            return self._do(run, a, self._column(self._number(b, node)))
        raise refuse(node, f"{type(op).__name__} of {a.kind} and {b.kind}")

    def _choose(self, node: ast.AST, condition: _Value, a: _Value, b: _Value) -> _Value:
        """``a`` in the environments where the condition holds, else ``b``."""
        if a.kind != b.kind:
            if a.size or b.size:
                raise refuse(node, f"either {a.kind} or {b.kind}; it must be of one kind")
            a, b = self._number(a, node), self._number(b, node)
        return self._do(torch.where, self._column(condition) if a.size else condition, a, b)

    def _column(self, value: _Value) -> _Value:
        """``(n, 1)``, to go with vectors."""
        return self._do(partial(torch.unsqueeze, dim=-1), value)
