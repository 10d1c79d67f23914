"""From a program's tree to a straight line of torch calls.

The tree is walked once. Every expression becomes a step that writes one register; an
``if`` becomes both branches and a ``where`` for each variable that they leave different.
Nothing that a program says is ever run as Python.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.rewards.functions import (
    FUNCTIONS,
    NUMBER,
    TRUTH,
    Function,
    Kind,
    choose_vector,
    component,
    vector_of,
)
from needlehoop.rewards.grammar import ProgramError
from needlehoop.signals import TABLE, vocabulary

MAX_STATEMENTS = 100
"""Statements in a program, those inside ifs included."""
MAX_NODES = 2000
"""Names, numbers and operations in a program."""
MAX_DEPTH = 64
"""Operations inside each other in one expression."""
MAX_NESTING = 16
"""Ifs inside each other, ``elif`` included."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""

RESULT = "reward"
"""The variable that holds a program's value."""


class Value(NamedTuple):
    """A register and what is in it."""

    register: int
    kind: Kind


class Partial(NamedTuple):
    """A variable that only one branch of an if assigns."""

    line: int


Variables = dict[str, Value | Partial]


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


def compile_tree(tree: ast.Module) -> Code:
    """The code of a parsed program.

    Raises:
        ProgramError: what is not in the language, does not fit together or is too much.
    """
    return _Compiler().compile(tree)


def _times(vector: Tensor, number: Tensor) -> Tensor:
    return vector * number.unsqueeze(-1)


def _over(vector: Tensor, number: Tensor) -> Tensor:
    return vector / number.unsqueeze(-1)


_ARITHMETIC: dict[type[ast.operator], tuple[str, Callable[..., Tensor]]] = {
    ast.Add: ("+", torch.add),
    ast.Sub: ("-", torch.sub),
    ast.Mult: ("*", torch.mul),
    ast.Div: ("/", torch.div),
}
_COMPARISONS: dict[type[ast.cmpop], tuple[str, Callable[..., Tensor]]] = {
    ast.Lt: ("<", torch.lt),
    ast.LtE: ("<=", torch.le),
    ast.Gt: (">", torch.gt),
    ast.GtE: (">=", torch.ge),
    ast.Eq: ("==", torch.eq),
    ast.NotEq: ("!=", torch.ne),
}


class _Compiler:
    def __init__(self):
        self._registers: list[Tensor | None] = []
        self._loads: dict[str, Value] = {}
        self._steps: list[Step] = []
        self._known: dict[object, Value] = {}
        """Results by what they are computed from: nothing is computed twice."""
        self._variables: Variables = {}
        self._statements = self._nodes = self._depth = self._nesting = 0
        self._last: tuple[ast.stmt, dict[str, Value]] | None = None
        """The last assignment to the result, and the terms it is the sum of."""

    def compile(self, tree: ast.Module) -> Code:
        self._block(tree.body)
        found = self._variables.get(RESULT)
        if not isinstance(found, Value):
            end = tree.body[-1].end_lineno if tree.body else None
            some = " in only one branch of an if" if isinstance(found, Partial) else " nowhere"
            raise ProgramError(
                end or 1, 1, f"{RESULT!r} is assigned{some}; a program's value is that variable"
            )
        last = tree.body[-1] if self._last is None else self._last[0]
        terms = {RESULT: self._number(found, last, RESULT)}
        if self._last is not None and self._last[1]:
            terms = {name: self._number(v, last, name) for name, v in self._last[1].items()}
        return self._finish(terms)

    def _finish(self, terms: dict[str, Value]) -> Code:
        """Drop what no term needs."""
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

    # Statements.

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statements += 1
            if self._statements > MAX_STATEMENTS:
                raise _refuse(statement, f"a program has at most {MAX_STATEMENTS} statements")
            match statement:
                case ast.Assign(targets=[ast.Name() as target], value=value):
                    self._assign(statement, target, value)
                case ast.Assign():
                    raise _refuse(statement, "an assignment has one name on its left")
                case ast.AugAssign(target=ast.Name() as target, op=op, value=value):
                    old = self._name(target, target.id)
                    self._set(target, self._arithmetic(statement, op, old, self._value(value)))
                    self._note(statement, target.id, {})
                case ast.If():
                    self._if(statement)
                case _:
                    raise _refuse(statement, f"{_called(statement)} not in the language")

    def _assign(self, statement: ast.stmt, target: ast.Name, expression: ast.expr) -> None:
        value = self._value(expression)
        names = _summed(expression)
        terms: dict[str, Value] = {}
        if target.id == RESULT and not self._nesting:
            distinct = len(set(names)) == len(names)
            if names and distinct and RESULT not in names:
                terms = {name: self._name(expression, name) for name in names}
        self._set(target, value)
        self._note(statement, target.id, terms)

    def _note(self, statement: ast.stmt, name: str, terms: dict[str, Value]) -> None:
        if name == RESULT:
            self._last = statement, terms

    def _set(self, target: ast.Name, value: Value) -> None:
        for table, what in ((TABLE, "signal"), (FUNCTIONS, "function")):
            if target.id in table:
                raise _refuse(target, f"{target.id!r} is a {what}; choose another name")
        self._variables[target.id] = value

    def _if(self, statement: ast.If) -> None:
        condition = self._truth(self._value(statement.test), statement.test, "a condition")
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise _refuse(statement, f"more than {MAX_NESTING} ifs inside each other")
        before = self._variables
        self._variables = dict(before)
        self._block(statement.body)
        then, self._variables = self._variables, dict(before)
        self._block(statement.orelse)
        self._nesting -= 1
        other = self._variables
        self._variables = {
            name: self._merge(statement, name, condition, then.get(name), other.get(name))
            for name in {**then, **other}
        }

    def _merge(
        self,
        statement: ast.If,
        name: str,
        condition: Value,
        then: Value | Partial | None,
        other: Value | Partial | None,
    ) -> Value | Partial:
        if isinstance(then, Value) and isinstance(other, Value):
            if then == other:
                return then
            return self._choose(statement, f"{name!r} after the if", condition, then, other)
        if isinstance(then, Partial):
            return then
        return other if isinstance(other, Partial) else Partial(statement.lineno)

    # Expressions.

    def _value(self, node: ast.expr) -> Value:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise _refuse(node, f"a program has at most {MAX_NODES} names, numbers and operations")
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _refuse(node, f"more than {MAX_DEPTH} operations inside each other; split it up")
        found = self._expression(node)
        self._depth -= 1
        return found

    def _expression(self, node: ast.expr) -> Value:
        match node:
            case ast.Constant(value=bool() as truth):
                return self._constant(torch.tensor(truth), ("truth", truth), TRUTH)
            case ast.Constant(value=int() | float() as number):
                tensor = torch.tensor(float(number), dtype=torch.float64)
                return self._constant(tensor, ("number", float(number)), NUMBER)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=op, operand=operand):
                return self._unary(node, op, self._value(operand))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(node, self._value(left), right)
            case ast.BinOp(left=left, op=op, right=right):
                return self._arithmetic(node, op, self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=operands):
                return self._all_or_any(op, operands)
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self._truth(self._value(test), test, "a condition")
                a, b = self._value(body), self._value(orelse)
                return self._choose(node, "a conditional expression", condition, a, b)
            case ast.Call():
                return self._call(node)
            case _:
                raise _refuse(node, f"{_called(node)} not in the language")

    def _constant(self, tensor: Tensor, key: object, kind: Kind) -> Value:
        if key not in self._known:
            self._known[key] = Value(self._register(tensor), kind)
        return self._known[key]

    def _name(self, node: ast.expr, name: str) -> Value:
        if name in self._variables:
            found = self._variables[name]
            if isinstance(found, Partial):
                raise _refuse(
                    node,
                    f"{name!r} has no value yet where the if on line {found.line} goes the other"
                    " way; assign it before, or in every branch",
                )
            return found
        signals = vocabulary()
        if name in signals:
            if name not in self._loads:
                row = signals[name]
                plain = TRUTH if row.unit == "bool" else NUMBER
                kind = vector_of(*row.shape) if row.shape else plain
                self._loads[name] = Value(self._register(None), kind)
            return self._loads[name]
        if name in TABLE:
            raise _refuse(node, f"{name!r} is the verdict, which no program may read")
        if name in FUNCTIONS:
            raise _refuse(node, f"{name!r} is a function: {FUNCTIONS[name].signature}")
        own = f"; variables: {', '.join(self._variables)}" if self._variables else ""
        raise _refuse(node, f"{name!r} is unknown; signals: {', '.join(signals)}{own}")

    def _unary(self, node: ast.UnaryOp, op: ast.unaryop, value: Value) -> Value:
        match op:
            case ast.Not():
                return self._emit("not", torch.logical_not, [self._truth(value, node, "not")])
            case ast.USub():
                value = value if value.kind.size else self._number(value, node, "-")
                return self._emit("negative", torch.neg, [value], value.kind)
            case ast.UAdd():
                return value if value.kind.size else self._number(value, node, "+")
            case _:
                raise _refuse(node, f"{type(op).__name__} is not in the language")

    def _arithmetic(self, node: ast.AST, op: ast.operator, a: Value, b: Value) -> Value:
        if type(op) not in _ARITHMETIC:
            raise _refuse(
                node, f"{_OPERATORS.get(type(op), 'this operator')} is not in the language"
            )
        sign, run = _ARITHMETIC[type(op)]
        if not a.kind.size and not b.kind.size:
            pair = [self._number(a, node, sign), self._number(b, node, sign)]
            return self._emit(sign, run, pair, NUMBER)
        if a.kind == b.kind and sign in "+-":
            return self._emit(sign, run, [a, b], a.kind)
        if sign == "*" and not a.kind.size:
            a, b = b, a
        if sign in "*/" and not b.kind.size:
            scale = _times if sign == "*" else _over
            return self._emit(f"vector {sign}", scale, [a, self._number(b, node, sign)], a.kind)
        raise _refuse(
            node,
            f"{sign} between {a.kind} and {b.kind}; vectors are added to vectors of their length,"
            " and scaled by numbers",
        )

    def _power(self, node: ast.BinOp, base: Value, exponent: ast.expr) -> Value:
        value = _literal(exponent)
        if value is None or abs(value) > MAX_EXPONENT:
            raise _refuse(
                exponent, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
            )
        run = partial(torch.pow, exponent=value)
        return self._emit(("**", value), run, [self._number(base, node, "**")], NUMBER)

    def _all_or_any(self, op: ast.boolop, operands: list[ast.expr]) -> Value:
        word, run = (
            ("and", torch.logical_and)
            if isinstance(op, ast.And)
            else (
                "or",
                torch.logical_or,
            )
        )
        first, *rest = [self._truth(self._value(one), one, word) for one in operands]
        for one in rest:
            first = self._emit(word, run, [first, one])
        return first

    def _compare(self, node: ast.Compare) -> Value:
        values = [self._value(one) for one in (node.left, *node.comparators)]
        found: Value | None = None
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in _COMPARISONS:
                raise _refuse(node, f"choose from {_listed(_COMPARISONS)} to compare")
            sign, run = _COMPARISONS[type(op)]
            pair = [self._number(one, node, sign) for one in (a, b)]
            one = self._emit(sign, run, pair)
            found = one if found is None else self._emit("and", torch.logical_and, [found, one])
        assert found is not None
        return found

    def _choose(self, node: ast.AST, what: str, condition: Value, a: Value, b: Value) -> Value:
        if a.kind != b.kind:
            if a.kind.size or b.kind.size:
                raise _refuse(node, f"{what} is {a.kind} or {b.kind}; it must be of one kind")
            a, b = self._number(a, node, what), self._number(b, node, what)
        run = choose_vector if a.kind.size else torch.where
        return self._emit("where", run, [condition, a, b], a.kind)

    # Calls.

    def _call(self, node: ast.Call) -> Value:
        if not isinstance(node.func, ast.Name):
            raise _refuse(node, "only a function's name can be called")
        name = node.func.id
        if name not in FUNCTIONS:
            raise _refuse(node, f"{name!r} is no function; choose from {', '.join(FUNCTIONS)}")
        function = FUNCTIONS[name]
        if node.keywords:
            raise _refuse(node, f"no keywords in a call; {function.signature}")
        for argument in node.args:
            if isinstance(argument, ast.Starred):
                raise _refuse(argument, "starred arguments are not in the language")
        wanted = len(function.takes)
        if len(node.args) < wanted or (len(node.args) > wanted and not function.more):
            raise _refuse(node, f"{len(node.args)} arguments; {function.signature}")
        if function.takes[-1] == "index":
            return self._component(node)
        values = [self._value(argument) for argument in node.args]
        if name == "where":
            condition = self._truth(values[0], node.args[0], name)
            return self._choose(node, name, condition, values[1], values[2])
        takes = (*function.takes, *function.takes[-1:] * (len(values) - wanted))
        fitted = [
            self._fit(value, wish, argument, function)
            for value, wish, argument in zip(values, takes, node.args, strict=True)
        ]
        sizes = {value.kind.size for value in fitted}
        if set(takes) == {"vector"} and len(sizes) > 1:
            raise _refuse(node, f"vectors of {' and '.join(map(str, sorted(sizes)))} components")
        kind = vector_of(3) if function.gives == "vector3" else NUMBER
        return self._emit(name, function.run, fitted, kind)

    def _fit(self, value: Value, wish: str, node: ast.expr, function: Function) -> Value:
        if wish == "number":
            return self._number(value, node, function.signature)
        sizes = {"vector3": (3,), "vector4": (4,)}.get(wish)
        if not value.kind.size or (sizes and value.kind.size not in sizes):
            raise _refuse(node, f"{value.kind}, where {function.signature} takes a {_SPOKEN[wish]}")
        return value

    def _component(self, node: ast.Call) -> Value:
        value = self._value(node.args[0])
        index = _literal(node.args[1])
        size = value.kind.size
        if not size:
            raise _refuse(node.args[0], f"{value.kind} has no components")
        if index is None or index != int(index) or not 0 <= index < size:
            raise _refuse(node.args[1], f"the index is one of 0 to {size - 1}, written out")
        run = partial(component, index=int(index))
        return self._emit(("component", int(index)), run, [value], NUMBER)

    # Registers.

    def _number(self, value: Value, node: ast.AST, what: str) -> Value:
        """A number as it is, a truth value as 0 or 1."""
        if value.kind.size:
            raise _refuse(node, f"{value.kind}, where {what} takes a number")
        return (
            value if value.kind == NUMBER else self._emit("number", Tensor.double, [value], NUMBER)
        )

    def _truth(self, value: Value, node: ast.AST, what: str) -> Value:
        if value.kind != TRUTH:
            raise _refuse(node, f"{value.kind}, where {what} takes a truth value, such as a < b")
        return value

    def _emit(
        self, key: object, run: Callable[..., Tensor], takes: list[Value], kind: Kind = TRUTH
    ) -> Value:
        """The result of a call; of constants, computed here and now."""
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

    def _register(self, tensor: Tensor | None) -> int:
        self._registers.append(tensor)
        return len(self._registers) - 1


_OPERATORS: dict[type[ast.operator], str] = {
    ast.FloorDiv: "//",
    ast.Pow: "**=",
    ast.LShift: "<<",
    ast.RShift: ">>",
}
_SPOKEN = {"vector": "vector", "vector3": "3-vector", "vector4": "4-vector"}
_CALLED = {
    ast.Expr: "a statement that assigns nothing is",
    ast.AnnAssign: "annotations are",
    ast.Tuple: "tuples are",
    ast.NamedExpr: "assignment inside an expression is",
}


def _called(node: ast.AST) -> str:
    return _CALLED.get(type(node), f"{type(node).__name__} is")


def _listed(table: dict) -> str:
    return ", ".join(sign for sign, _ in table.values())


def _refuse(node: ast.AST, reason: str) -> ProgramError:
    return ProgramError(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, reason)


def _literal(node: ast.expr) -> float | None:
    """A number that is written out, with its sign."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            value = _literal(operand)
            return None if value is None else -value
        case ast.Constant(value=bool()):
            return None
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case _:
            return None


def _summed(node: ast.expr) -> list[str]:
    """The names whose plain sum an expression is; none if it is anything else."""
    names: list[str] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        if not isinstance(node.right, ast.Name):
            return []
        names.append(node.right.id)
        node = node.left
    if not isinstance(node, ast.Name) or not names:
        return []
    return [node.id, *reversed(names)]
