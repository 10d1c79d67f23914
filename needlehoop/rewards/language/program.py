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
MAX_NESTING = 16
"""Ifs inside each other, ``elif`` included."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

RESULT = "reward"
"""The variable that holds a program's value."""


Step = tuple[Callable[..., Any], tuple[int, ...]]
"""A call, and what it takes: the signals are number 0, results of earlier steps count from 1."""


@dataclass(frozen=True)
class Program:
    """A compiled program, which is a reward. Two programs are equal if their sources are.

    ``results`` has the number of each term's step: of what the last ``reward = a + b`` sums, else
    of ``reward``.
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
    ``(n, k)`` float64 a k-vector. ``n`` is 1 here, and for what is always the same.
    """

    number: int
    like: Any

    @property
    def size(self) -> int:
        """The length of a vector; 0 for a number or a truth value."""
        return self.like.shape[1] if self.like.ndim == 2 else 0

    @property
    def is_truth(self) -> bool:
        """Whether it is true or false."""
        return self.like.dtype == torch.bool

    @property
    def kind(self) -> str:
        if self.size:
            return f"a {self.size}-vector"
        return "a truth value" if self.is_truth else "a number"


class _Compiler:
    """Compiles one program. Its methods raise ``ProgramError`` for what is not in the language."""

    def __init__(self, table: Mapping[str, Signal]):
        self._table = table
        kinds = {
            name: torch.bool if s.unit == "bool" else torch.float64 for name, s in table.items()
        }
        zero = {name: torch.zeros(1, *s.shape, dtype=kinds[name]) for name, s in table.items()}
        self._signals, self._steps = _Value(0, SimpleNamespace(**zero)), []
        self._variables: dict[str, _Value | int] = {}
        """Values by name; the line of an if that assigns a variable in only one branch."""
        self._summands: dict[str, _Value] = {}
        """What the result is the plain sum of, if it is one."""
        self._last: ast.stmt | None = None
        """The last assignment to the result."""
        self._nodes = self._depth = self._statements = self._nesting = 0

    def program(self, source: str) -> Program:
        """The whole program."""
        body = parse(source).body
        self._block(body)
        found = self._variables.get(RESULT)
        if not isinstance(found, _Value):
            end = body[-1].end_lineno if body else None
            some = "nowhere" if found is None else "in only one branch of an if"
            raise ProgramError(
                end or 1, 1, f"{RESULT!r} is assigned {some}; a program's value is that variable"
            )
        last, terms = self._last, self._summands or {RESULT: found}
        assert last is not None
        results = {name: self._number(one, last, name).number for name, one in terms.items()}
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
                case ast.Assign(targets=[ast.Name() as target], value=expression):
                    value = self._value(expression)
                    self._assign(statement, target, value, self._summed(target, expression))
                case ast.Assign():
                    raise refuse(statement, "an assignment has one name on its left")
                case ast.AugAssign(target=ast.Name() as target, op=op, value=expression):
                    old = self._name(target, target.id)
                    changed = self._arithmetic(statement, op, old, self._value(expression))
                    self._assign(statement, target, changed, {})
                case ast.If():
                    self._if(statement)
                case _:
                    raise foreign(statement)

    def _assign(
        self, statement: ast.stmt, target: ast.Name, value: _Value, summands: dict[str, _Value]
    ) -> None:
        for table, what in ((self._table, "signal"), (FUNCTIONS, "function")):
            if target.id in table:
                raise refuse(target, f"{target.id!r} is a {what}; choose another name")
        self._variables[target.id] = value
        if target.id == RESULT:
            self._last, self._summands = statement, summands

    def _summed(self, target: ast.Name, expression: ast.expr) -> dict[str, _Value]:
        """The variables and signals that the result is the plain sum of, outside every if."""
        names = summed(expression)
        plain = target.id == RESULT and not self._nesting and RESULT not in names
        if not plain or len(set(names)) < len(names):
            return {}
        return {name: self._name(expression, name) for name in names}

    def _if(self, statement: ast.If) -> None:
        condition = _truth(self._value(statement.test), statement.test, "a condition")
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise refuse(statement, f"more than {MAX_NESTING} ifs inside each other")
        before, branches = self._variables, []
        for body in (statement.body, statement.orelse):
            self._variables = dict(before)
            self._block(body)
            branches.append(self._variables)
        self._nesting -= 1
        then, other = branches
        self._variables = {}
        for name in {**then, **other}:
            ends = then.get(name), other.get(name)
            match ends:
                case (_Value() as a, _Value() as b):
                    what = f"{name!r} after the if"
                    value = a if a is b else self._choose(statement, what, condition, a, b)
                case _:
                    lines = (one for one in ends if isinstance(one, int))
                    value = next(lines, statement.lineno)
            self._variables[name] = value

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
                dtype = torch.bool if isinstance(value, bool) else torch.float64
                tensor = torch.tensor([value], dtype=dtype)
                return self._do(lambda: tensor)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=op, operand=operand):
                return self._unary(node, op, self._value(operand))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                base, exponent = self._value(left), literal(right)
                if exponent is None or abs(exponent) > MAX_EXPONENT:
                    raise refuse(
                        right, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
                    )
                power = partial(torch.pow, exponent=exponent)
                return self._do(power, self._number(base, node, "**"))
            case ast.BinOp(left=left, op=op, right=right):
                return self._arithmetic(node, op, self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=operands):
                word, run = JUNCTIONS[type(op)]
                values = [_truth(self._value(one), one, word) for one in operands]
                return reduce(partial(self._do, run), values)
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self._compare(node, ops, [self._value(one) for one in (left, *others)])
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = _truth(self._value(test), test, "a condition")
                a, b = self._value(body), self._value(orelse)
                return self._choose(node, "a conditional expression", condition, a, b)
            case ast.Call():
                return self._call(node)
            case _:
                raise foreign(node)

    def _name(self, node: ast.expr, name: str) -> _Value:
        """The value of a variable or a signal."""
        found = self._variables.get(name)
        if isinstance(found, _Value):
            return found
        if found is not None:
            raise refuse(
                node,
                f"{name!r} has no value yet where the if on line {found} goes the other way;"
                " assign it before, or in every branch",
            )
        if name in self._table:
            if self._table[name].source != "verdict":
                return self._do(attrgetter(name), self._signals)
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        if name in FUNCTIONS:
            raise refuse(node, f"{name!r} is a function: {FUNCTIONS[name].signature}")
        own = f"; variables: {', '.join(self._variables)}" if self._variables else ""
        raise refuse(
            node, f"{name!r} is unknown; signals: {', '.join(vocabulary(self._table))}{own}"
        )

    def _compare(self, node: ast.Compare, ops: list[ast.cmpop], values: list[_Value]) -> _Value:
        """``a < b < c`` is ``a < b and b < c``."""
        found = []
        for op, *pair in zip(ops, values, values[1:], strict=False):
            sign, run = COMPARISONS[type(op)]
            found.append(self._do(run, *(self._number(value, node, sign) for value in pair)))
        return reduce(partial(self._do, torch.logical_and), found)

    def _call(self, node: ast.Call) -> _Value:
        if not isinstance(node.func, ast.Name):
            raise refuse(node, "only a function's name can be called")
        name, given = node.func.id, node.args
        if name not in FUNCTIONS:
            raise refuse(node, f"{name!r} is no function; choose from {', '.join(FUNCTIONS)}")
        function = FUNCTIONS[name]
        takes, signature = function.takes, function.signature
        if node.keywords:
            raise refuse(node, f"no keywords in a call; {signature}")
        more = len(given) - len(takes)
        if more < 0 or (more and "..." not in signature):
            raise refuse(node, f"{len(given)} arguments; {signature}")
        if name == "component":
            return self._component(given[0], given[1])
        values = [self._value(argument) for argument in given]
        if name == "where":
            condition, a, b = values
            return self._choose(node, name, _truth(condition, given[0], name), a, b)
        fitted = [
            self._fit(value, wish, argument, signature)
            for value, wish, argument in zip(values, takes + takes[-1:] * more, given, strict=True)
        ]
        sizes = sorted({value.size for value in fitted})
        if set(takes) == {"vector"} and len(sizes) > 1:
            raise refuse(node, f"vectors of {' and '.join(map(str, sizes))} components")
        return self._do(function.run, *fitted)

    def _component(self, vector: ast.expr, index: ast.expr) -> _Value:
        value, number = self._value(vector), literal(index)
        if not value.size:
            raise refuse(vector, f"{value.kind} has no components")
        if number is None or number != int(number) or not 0 <= number < value.size:
            raise refuse(index, f"the index is one of 0 to {value.size - 1}, written out")
        return self._do(itemgetter((..., int(number))), value)

    # Operations.

    def _number(self, value: _Value, node: ast.AST, what: str) -> _Value:
        """A number as it is; a truth value as 0 or 1. A vector is refused."""
        return self._fit(value, "number", node, what)

    def _fit(self, value: _Value, wish: str, node: ast.AST, what: str) -> _Value:
        """A value as an argument: ``number``, ``vector``, ``vector3`` or ``vector4``."""
        wanted = wish.removeprefix("vector")
        if wish == "number" and not value.size:
            return self._do(Tensor.double, value) if value.is_truth else value
        if wish == "number" or not value.size or wanted not in ("", str(value.size)):
            taken = f"{wanted}-vector" if wanted.isdigit() else wish
            raise refuse(node, f"{value.kind}, where {what} takes a {taken}")
        return value

    def _unary(self, node: ast.UnaryOp, op: ast.unaryop, value: _Value) -> _Value:
        if isinstance(op, ast.Not):
            return self._do(torch.logical_not, _truth(value, node, "not"))
        sign = "-" if isinstance(op, ast.USub) else "+"
        value = value if value.size else self._number(value, node, sign)
        return self._do(torch.neg, value) if sign == "-" else value

    def _arithmetic(self, node: ast.AST, op: ast.operator, a: _Value, b: _Value) -> _Value:
        if type(op) not in ARITHMETIC:
            signs = ", ".join(sign for sign, _ in ARITHMETIC.values())
            raise refuse(node, f"{type(op).__name__} is not in the language; choose from {signs}")
        sign, run = ARITHMETIC[type(op)]
        if not a.size and not b.size:
            return self._do(run, self._number(a, node, sign), self._number(b, node, sign))
        if a.size == b.size and sign in "+-":
            return self._do(run, a, b)
        if sign == "*" and not a.size:
            a, b = b, a
        if sign in "*/" and not b.size:
            return self._do(run, a, self._column(self._number(b, node, sign)))
        raise refuse(
            node,
            f"{sign} between {a.kind} and {b.kind}; vectors are added to vectors of their length,"
            " and scaled by numbers",
        )

    def _choose(self, node: ast.AST, what: str, condition: _Value, a: _Value, b: _Value) -> _Value:
        """``a`` in the environments where the condition holds, else ``b``."""
        if a.kind != b.kind:
            if a.size or b.size:
                raise refuse(node, f"{what} is {a.kind} or {b.kind}; it must be of one kind")
            a, b = self._number(a, node, what), self._number(b, node, what)
        return self._do(torch.where, self._column(condition) if a.size else condition, a, b)

    def _column(self, value: _Value) -> _Value:
        """``(n, 1)``, to go with vectors."""
        return self._do(partial(torch.unsqueeze, dim=-1), value)


def _truth(value: _Value, node: ast.AST, what: str) -> _Value:
    """A truth value as it is. Anything else is refused."""
    if not value.is_truth:
        raise refuse(node, f"{value.kind}, where {what} takes a truth value, such as a < b")
    return value
