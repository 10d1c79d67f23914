"""Expressions: each becomes steps on a tape, and a value of one of the language's kinds."""

from __future__ import annotations

import ast
from functools import partial

import torch

from needlehoop.rewards.language.calls import Calls
from needlehoop.rewards.language.functions import FUNCTIONS, NUMBER, TRUTH, vector_of
from needlehoop.rewards.language.operators import ARITHMETIC, COMPARISONS, JUNCTIONS, over, times
from needlehoop.rewards.language.scope import Scope
from needlehoop.rewards.language.tape import Tape, Value
from needlehoop.rewards.language.tree import foreign, literal, refuse
from needlehoop.scene.vocabulary import TABLE, vocabulary

MAX_NODES = 2000
"""Names, numbers and operations in a program."""
MAX_DEPTH = 64
"""Operations inside each other in one expression."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

_ELSEWHERE: dict[type[ast.operator], str] = {
    ast.FloorDiv: "//",
    ast.Pow: "**=",
    ast.LShift: "<<",
    ast.RShift: ">>",
}
"""Signs that get past the grammar's tokens and are no operators here."""


class Expressions:
    """Writes the expressions of one program.

    Args:
        tape: where.
        scope: the variables that they read.
    """

    def __init__(self, tape: Tape, scope: Scope):
        self._tape, self._scope = tape, scope
        self._calls = Calls(tape, self.value)
        self._nodes = self._depth = 0

    def value(self, node: ast.expr) -> Value:
        """An expression's value.

        Raises:
            ProgramError: what is not in the language, does not fit together or is too much.
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

    def condition(self, node: ast.expr) -> Value:
        """The truth value that an if depends on; errors as in ``value``."""
        return self._tape.truth(self.value(node), node, "a condition")

    def name(self, node: ast.expr, name: str) -> Value:
        """The variable or signal of a name; errors as in ``value``."""
        found = self._scope.get(node, name)
        if found is not None:
            return found
        signals = vocabulary()
        if name in signals:
            row = signals[name]
            plain = TRUTH if row.unit == "bool" else NUMBER
            return self._tape.signal(name, vector_of(*row.shape) if row.shape else plain)
        if name in TABLE:
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        if name in FUNCTIONS:
            raise refuse(node, f"{name!r} is a function: {FUNCTIONS[name].signature}")
        variables = self._scope.variables
        own = f"; variables: {', '.join(variables)}" if variables else ""
        raise refuse(node, f"{name!r} is unknown; signals: {', '.join(signals)}{own}")

    def arithmetic(self, node: ast.AST, op: ast.operator, a: Value, b: Value) -> Value:
        """``a op b``; errors as in ``value``."""
        if type(op) not in ARITHMETIC:
            raise refuse(
                node, f"{_ELSEWHERE.get(type(op), 'this operator')} is not in the language"
            )
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

    def _expression(self, node: ast.expr) -> Value:
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
                return self._calls.call(node)
            case _:
                raise foreign(node)

    def _unary(self, node: ast.UnaryOp, op: ast.unaryop, value: Value) -> Value:
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

    def _power(self, node: ast.BinOp, base: Value, exponent: ast.expr) -> Value:
        value = literal(exponent)
        if value is None or abs(value) > MAX_EXPONENT:
            raise refuse(
                exponent, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
            )
        run = partial(torch.pow, exponent=value)
        return self._tape.emit(("**", value), run, [self._tape.number(base, node, "**")], NUMBER)

    def _junction(self, op: ast.boolop, operands: list[ast.expr]) -> Value:
        word, run = JUNCTIONS[type(op)]
        first, *rest = [self._tape.truth(self.value(one), one, word) for one in operands]
        for one in rest:
            first = self._tape.emit(word, run, [first, one])
        return first

    def _compare(self, node: ast.Compare) -> Value:
        tape = self._tape
        values = [self.value(one) for one in (node.left, *node.comparators)]
        found: Value | None = None
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS:
                signs = ", ".join(sign for sign, _ in COMPARISONS.values())
                raise refuse(node, f"choose from {signs} to compare")
            sign, run = COMPARISONS[type(op)]
            one = tape.emit(sign, run, [tape.number(value, node, sign) for value in (a, b)])
            found = one if found is None else tape.emit("and", torch.logical_and, [found, one])
        assert found is not None
        return found
