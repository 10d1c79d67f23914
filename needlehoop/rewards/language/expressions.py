"""Expressions of a program: each becomes steps on a tape, and a register of a known kind."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import torch

from needlehoop.rewards.language.functions import (
    ARITHMETIC,
    COMPARISONS,
    FUNCTIONS,
    JUNCTIONS,
    NUMBER,
    TRUTH,
    Function,
    component,
    over,
    times,
    vector_of,
)
from needlehoop.rewards.language.grammar import foreign, literal, refuse
from needlehoop.rewards.language.tape import Register, Tape
from needlehoop.scene.signals import Signal, vocabulary

MAX_NODES = 2000
"""Names, numbers and operations in a program."""
MAX_DEPTH = 64
"""Operations inside each other in one expression."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

_NO_OPERATORS: dict[type[ast.operator], str] = {
    ast.FloorDiv: "//",
    ast.Pow: "**=",
    ast.LShift: "<<",
    ast.RShift: ">>",
}
"""Signs that consist of allowed tokens but are not operators of the language."""

_VECTORS = {"vector": "vector", "vector3": "3-vector", "vector4": "4-vector"}
"""How a refusal names what a function takes."""


class Partial(NamedTuple):
    """A variable that is assigned in only one branch of the if on ``line``."""

    line: int


Variables = dict[str, Register | Partial]


class Expressions:
    """Writes the expressions of one program on a tape.

    ``variables`` are the program's, by name. Statements assign them; expressions read them.
    """

    def __init__(self, tape: Tape, table: Mapping[str, Signal]):
        self._table = table
        self.variables: Variables = {}
        self._tape = tape
        self._nodes = self._depth = 0

    def value(self, node: ast.expr) -> Register:
        """An expression's value.

        Raises:
            ProgramError: it uses something outside the language, mixes kinds, or is too large.
        """
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise refuse(node, f"a program has at most {MAX_NODES} names, numbers and operations")
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise refuse(node, f"more than {MAX_DEPTH} operations inside each other; split it up")
        found = self._expression(node)
        self._depth -= 1
        return found

    def condition(self, node: ast.expr) -> Register:
        """The truth value that an if depends on; errors as in ``value``."""
        return self._tape.truth(self.value(node), node, "a condition")

    def name(self, node: ast.expr, name: str) -> Register:
        """The variable or signal of a name; errors as in ``value``."""
        found = self.variables.get(name)
        if isinstance(found, Partial):
            raise refuse(
                node,
                f"{name!r} has no value yet where the if on line {found.line} goes the other"
                " way; assign it before, or in every branch",
            )
        if found is not None:
            return found
        signals = vocabulary(self._table)
        if name in signals:
            row = signals[name]
            plain = TRUTH if row.unit == "bool" else NUMBER
            return self._tape.signal(name, vector_of(*row.shape) if row.shape else plain)
        if name in self._table:
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        if name in FUNCTIONS:
            raise refuse(node, f"{name!r} is a function: {FUNCTIONS[name].signature}")
        own = f"; variables: {', '.join(self.variables)}" if self.variables else ""
        raise refuse(node, f"{name!r} is unknown; signals: {', '.join(signals)}{own}")

    def arithmetic(self, node: ast.AST, op: ast.operator, a: Register, b: Register) -> Register:
        """``a op b``; errors as in ``value``."""
        if type(op) not in ARITHMETIC:
            sign = _NO_OPERATORS.get(type(op), "this operator")
            raise refuse(node, f"{sign} is not in the language")
        tape, (sign, run) = self._tape, ARITHMETIC[type(op)]
        if not a.kind.size and not b.kind.size:
            pair = [tape.number(a, node, sign), tape.number(b, node, sign)]
            return tape.emit(sign, run, pair, NUMBER)
        if a.kind == b.kind and sign in "+-":
            return tape.emit(sign, run, [a, b], a.kind)
        if sign == "*" and not a.kind.size:
            a, b = b, a
        if sign in "*/" and not b.kind.size:
            scale = times if sign == "*" else over
            return tape.emit(f"vector {sign}", scale, [a, tape.number(b, node, sign)], a.kind)
        raise refuse(
            node,
            f"{sign} between {a.kind} and {b.kind}; vectors are added to vectors of their length,"
            " and scaled by numbers",
        )

    def _expression(self, node: ast.expr) -> Register:
        match node:
            case ast.Constant(value=bool() as truth):
                return self._tape.constant(truth)
            case ast.Constant(value=int() | float() as number):
                return self._tape.constant(float(number))
            case ast.Name(id=name):
                return self.name(node, name)
            case ast.UnaryOp(op=op, operand=operand):
                return self._unary(node, op, self.value(operand))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(node, self.value(left), right)
            case ast.BinOp(left=left, op=op, right=right):
                return self.arithmetic(node, op, self.value(left), self.value(right))
            case ast.BoolOp(op=op, values=operands):
                return self._junction(op, operands)
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self.condition(test)
                a, b = self.value(body), self.value(orelse)
                return self._tape.choose(node, "a conditional expression", condition, a, b)
            case ast.Call():
                return self._call(node)
            case _:
                raise foreign(node)

    def _unary(self, node: ast.UnaryOp, op: ast.unaryop, value: Register) -> Register:
        tape = self._tape
        match op:
            case ast.Not():
                return tape.emit("not", torch.logical_not, [tape.truth(value, node, "not")])
            case ast.USub():
                value = value if value.kind.size else tape.number(value, node, "-")
                return tape.emit("negative", torch.neg, [value], value.kind)
            case ast.UAdd():
                return value if value.kind.size else tape.number(value, node, "+")
            case _:
                raise refuse(node, f"{type(op).__name__} is not in the language")

    def _power(self, node: ast.BinOp, base: Register, exponent: ast.expr) -> Register:
        value = literal(exponent)
        if value is None or abs(value) > MAX_EXPONENT:
            raise refuse(
                exponent, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
            )
        run = partial(torch.pow, exponent=value)
        return self._tape.emit(("**", value), run, [self._tape.number(base, node, "**")], NUMBER)

    def _junction(self, op: ast.boolop, operands: list[ast.expr]) -> Register:
        word, run = JUNCTIONS[type(op)]
        first, *rest = [self._tape.truth(self.value(one), one, word) for one in operands]
        for one in rest:
            first = self._tape.emit(word, run, [first, one])
        return first

    def _compare(self, node: ast.Compare) -> Register:
        tape = self._tape
        values = [self.value(one) for one in (node.left, *node.comparators)]
        found: Register | None = None
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS:
                signs = ", ".join(sign for sign, _ in COMPARISONS.values())
                raise refuse(node, f"choose from {signs} to compare")
            sign, run = COMPARISONS[type(op)]
            one = tape.emit(sign, run, [tape.number(value, node, sign) for value in (a, b)])
            found = one if found is None else tape.emit("and", torch.logical_and, [found, one])
        assert found is not None
        return found

    def _call(self, node: ast.Call) -> Register:
        name, function = _function(node)
        if function.takes[-1] == "index":
            return self._component(node)
        values = [self.value(argument) for argument in node.args]
        if name == "where":
            condition = self._tape.truth(values[0], node.args[0], name)
            return self._tape.choose(node, name, condition, values[1], values[2])
        takes = function.takes
        takes = (*takes, *takes[-1:] * (len(values) - len(takes)))
        fitted = [
            self._fit(value, wish, argument, function)
            for value, wish, argument in zip(values, takes, node.args, strict=True)
        ]
        sizes = {value.kind.size for value in fitted}
        if set(takes) == {"vector"} and len(sizes) > 1:
            raise refuse(node, f"vectors of {' and '.join(map(str, sorted(sizes)))} components")
        kind = vector_of(3) if function.gives == "vector3" else NUMBER
        return self._tape.emit(name, function.run, fitted, kind)

    def _fit(self, value: Register, wish: str, node: ast.expr, function: Function) -> Register:
        if wish == "number":
            return self._tape.number(value, node, function.signature)
        size = {"vector3": 3, "vector4": 4}.get(wish, value.kind.size)
        if not value.kind.size or value.kind.size != size:
            raise refuse(node, f"{value.kind}, where {function.signature} takes a {_VECTORS[wish]}")
        return value

    def _component(self, node: ast.Call) -> Register:
        value = self.value(node.args[0])
        index = literal(node.args[1])
        size = value.kind.size
        if not size:
            raise refuse(node.args[0], f"{value.kind} has no components")
        if index is None or index != int(index) or not 0 <= index < size:
            raise refuse(node.args[1], f"the index is one of 0 to {size - 1}, written out")
        run = partial(component, index=int(index))
        return self._tape.emit(("component", int(index)), run, [value], NUMBER)


def _function(node: ast.Call) -> tuple[str, Function]:
    """The called function's name and row; refused unless it gets as many arguments as it takes."""
    if not isinstance(node.func, ast.Name):
        raise refuse(node, "only a function's name can be called")
    name = node.func.id
    if name not in FUNCTIONS:
        raise refuse(node, f"{name!r} is no function; choose from {', '.join(FUNCTIONS)}")
    function = FUNCTIONS[name]
    if node.keywords:
        raise refuse(node, f"no keywords in a call; {function.signature}")
    for argument in node.args:
        if isinstance(argument, ast.Starred):
            raise refuse(argument, "starred arguments are not in the language")
    wanted = len(function.takes)
    if len(node.args) < wanted or (len(node.args) > wanted and not function.more):
        raise refuse(node, f"{len(node.args)} arguments; {function.signature}")
    return name, function
