"""From a program's tree to a straight line of torch calls over numbered registers.

The tree is walked once, and every expression becomes a step that writes one register. An ``if``
becomes the steps of both branches, and a ``where`` for each variable they leave different.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.rewards.language.functions import (
    ARITHMETIC,
    COMPARISONS,
    FUNCTIONS,
    JUNCTIONS,
    NUMBER,
    TRUTH,
    Function,
    Kind,
    component,
    vector_of,
)
from needlehoop.rewards.language.grammar import ProgramError, foreign, literal, refuse, summed
from needlehoop.scene.signals import Signal, vocabulary

MAX_NODES = 2000
"""Names, numbers and operations in a program."""
MAX_DEPTH = 64
"""Operations inside each other in one expression."""
MAX_EXPONENT = 8
"""The largest exponent, which must be written out."""
MAX_STATEMENTS = 100
"""Statements in a program, those inside ifs included."""
MAX_NESTING = 16
"""Ifs inside each other, ``elif`` included."""

RESULT = "reward"
"""The variable that holds a program's value."""

_NO_OPERATORS: dict[type[ast.operator], str] = {
    ast.FloorDiv: "//",
    ast.Pow: "**=",
    ast.LShift: "<<",
    ast.RShift: ">>",
}
"""Signs that consist of allowed tokens but are not operators of the language."""


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


class Partial(NamedTuple):
    """A variable that is assigned in only one branch of the if on ``line``."""

    line: int


class Compiler:
    """Compiles one program. Its methods raise ``ProgramError`` for what is not in the language.

    The same call on the same registers is written once.
    """

    def __init__(self, table: Mapping[str, Signal]):
        self._table, self._readable = table, vocabulary(table)
        self._registers: list[Tensor | None] = []
        self._loads: dict[str, Register] = {}
        self._steps: list[Step] = []
        self._known: dict[object, Register] = {}
        """Results by what they are computed from."""
        self._variables: dict[str, Register | Partial] = {}
        self._nodes = self._depth = self._statements = self._nesting = 0
        self._last: tuple[ast.stmt, dict[str, Register]] | None = None
        """The last assignment to the result, and the terms it is the sum of."""

    def compile(self, tree: ast.Module) -> Code:
        """The steps that some term needs."""
        self._block(tree.body)
        found = self._variables.get(RESULT)
        if not isinstance(found, Register):
            end = tree.body[-1].end_lineno if tree.body else None
            some = " in only one branch of an if" if isinstance(found, Partial) else " nowhere"
            raise ProgramError(
                end or 1, 1, f"{RESULT!r} is assigned{some}; a program's value is that variable"
            )
        assert self._last is not None
        last, terms = self._last
        terms = {n: self._number(r, last, n) for n, r in (terms or {RESULT: found}).items()}
        needed = {register.index for register in terms.values()}
        steps = []
        for step in reversed(self._steps):
            if step.out in needed:
                needed.update(step.takes)
                steps.append(step)
        made = {step.out for step in steps}
        return Code(
            registers=tuple(self._registers),
            loads=tuple((n, r.index) for n, r in self._loads.items() if r.index in needed),
            steps=tuple(reversed(steps)),
            terms=tuple((n, r.index, r.index not in made) for n, r in terms.items()),
        )

    # Statements.

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statements += 1
            if self._statements > MAX_STATEMENTS:
                raise refuse(statement, f"a program has at most {MAX_STATEMENTS} statements")
            match statement:
                case ast.Assign(targets=[ast.Name() as target], value=expression):
                    value = self._value(expression)
                    self._assign(statement, target, value, self._terms(target, expression))
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
        self, statement: ast.stmt, target: ast.Name, value: Register, terms: dict[str, Register]
    ) -> None:
        for table, what in ((self._table, "signal"), (FUNCTIONS, "function")):
            if target.id in table:
                raise refuse(target, f"{target.id!r} is a {what}; choose another name")
        self._variables[target.id] = value
        if target.id == RESULT:
            self._last = statement, terms

    def _terms(self, target: ast.Name, expression: ast.expr) -> dict[str, Register]:
        """The variables and signals that the result is the plain sum of, outside every if."""
        names = summed(expression)
        plain = target.id == RESULT and not self._nesting and RESULT not in names
        if not plain or len(set(names)) < len(names):
            return {}
        return {name: self._name(expression, name) for name in names}

    def _if(self, statement: ast.If) -> None:
        condition = self._condition(statement.test)
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
        self._variables = {
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
            return self._choose(statement, f"{name!r} after the if", condition, then, other)
        if isinstance(then, Partial):
            return then
        return other if isinstance(other, Partial) else Partial(statement.lineno)

    # Expressions.

    def _value(self, node: ast.expr) -> Register:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise refuse(node, f"a program has at most {MAX_NODES} names, numbers and operations")
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise refuse(node, f"more than {MAX_DEPTH} operations inside each other; split it up")
        found = self._expression(node)
        self._depth -= 1
        return found

    def _expression(self, node: ast.expr) -> Register:
        match node:
            case ast.Constant(value=bool() as truth):
                return self._constant(truth)
            case ast.Constant(value=int() | float() as number):
                return self._constant(float(number))
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=op, operand=operand):
                return self._unary(node, op, self._value(operand))
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(node, self._value(left), right)
            case ast.BinOp(left=left, op=op, right=right):
                return self._arithmetic(node, op, self._value(left), self._value(right))
            case ast.BoolOp(op=op, values=operands):
                return self._junction(op, operands)
            case ast.Compare():
                return self._compare(node)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                condition = self._condition(test)
                a, b = self._value(body), self._value(orelse)
                return self._choose(node, "a conditional expression", condition, a, b)
            case ast.Call():
                return self._call(node)
            case _:
                raise foreign(node)

    def _condition(self, node: ast.expr) -> Register:
        return self._truth(self._value(node), node, "a condition")

    def _name(self, node: ast.expr, name: str) -> Register:
        """The variable or signal of a name; a signal is loaded once."""
        found = self._variables.get(name)
        if isinstance(found, Partial):
            raise refuse(
                node,
                f"{name!r} has no value yet where the if on line {found.line} goes the other"
                " way; assign it before, or in every branch",
            )
        if found is not None:
            return found
        if name in self._readable:
            row = self._readable[name]
            plain = TRUTH if row.unit == "bool" else NUMBER
            if name not in self._loads:
                kind = vector_of(*row.shape) if row.shape else plain
                self._loads[name] = Register(self._new(None), kind)
            return self._loads[name]
        if name in self._table:
            raise refuse(node, f"{name!r} is the verdict, which no program may read")
        if name in FUNCTIONS:
            raise refuse(node, f"{name!r} is a function: {FUNCTIONS[name].signature}")
        own = f"; variables: {', '.join(self._variables)}" if self._variables else ""
        raise refuse(node, f"{name!r} is unknown; signals: {', '.join(self._readable)}{own}")

    def _arithmetic(self, node: ast.AST, op: ast.operator, a: Register, b: Register) -> Register:
        if type(op) not in ARITHMETIC:
            sign = _NO_OPERATORS.get(type(op), "this operator")
            raise refuse(node, f"{sign} is not in the language")
        sign, run = ARITHMETIC[type(op)]
        if not a.kind.size and not b.kind.size:
            pair = [self._number(a, node, sign), self._number(b, node, sign)]
            return self._emit(sign, run, pair, NUMBER)
        if a.kind == b.kind and sign in "+-":
            return self._emit(sign, run, [a, b], a.kind)
        if sign == "*" and not a.kind.size:
            a, b = b, a
        if sign in "*/" and not b.kind.size:
            pair = [a, self._number(b, node, sign)]
            return self._emit(f"vector {sign}", partial(_scaled, run), pair, a.kind)
        raise refuse(
            node,
            f"{sign} between {a.kind} and {b.kind}; vectors are added to vectors of their length,"
            " and scaled by numbers",
        )

    def _unary(self, node: ast.UnaryOp, op: ast.unaryop, value: Register) -> Register:
        match op:
            case ast.Not():
                return self._emit("not", torch.logical_not, [self._truth(value, node, "not")])
            case ast.USub():
                value = value if value.kind.size else self._number(value, node, "-")
                return self._emit("negative", torch.neg, [value], value.kind)
            case ast.UAdd():
                return value if value.kind.size else self._number(value, node, "+")
            case _:
                raise refuse(node, f"{type(op).__name__} is not in the language")

    def _power(self, node: ast.BinOp, base: Register, exponent: ast.expr) -> Register:
        value = literal(exponent)
        if value is None or abs(value) > MAX_EXPONENT:
            raise refuse(
                exponent, f"an exponent is a number, written out, of at most {MAX_EXPONENT}"
            )
        run = partial(torch.pow, exponent=value)
        return self._emit(("**", value), run, [self._number(base, node, "**")], NUMBER)

    def _junction(self, op: ast.boolop, operands: list[ast.expr]) -> Register:
        word, run = JUNCTIONS[type(op)]
        first, *rest = [self._truth(self._value(one), one, word) for one in operands]
        for one in rest:
            first = self._emit(word, run, [first, one])
        return first

    def _compare(self, node: ast.Compare) -> Register:
        values = [self._value(one) for one in (node.left, *node.comparators)]
        found: Register | None = None
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            if type(op) not in COMPARISONS:
                signs = ", ".join(sign for sign, _ in COMPARISONS.values())
                raise refuse(node, f"choose from {signs} to compare")
            sign, run = COMPARISONS[type(op)]
            one = self._emit(sign, run, [self._number(value, node, sign) for value in (a, b)])
            found = one if found is None else self._emit("and", torch.logical_and, [found, one])
        assert found is not None
        return found

    def _call(self, node: ast.Call) -> Register:
        name, function = _function(node)
        if function.takes[-1] == "index":
            return self._component(node)
        values = [self._value(argument) for argument in node.args]
        if name == "where":
            condition = self._truth(values[0], node.args[0], name)
            return self._choose(node, name, condition, values[1], values[2])
        takes = function.takes
        takes = (*takes, *takes[-1:] * (len(values) - len(takes)))
        fitted = [
            self._fit(value, wish, argument, function)
            for value, wish, argument in zip(values, takes, node.args, strict=True)
        ]
        sizes = {value.kind.size for value in fitted}
        if set(takes) == {"vector"} and len(sizes) > 1:
            raise refuse(node, f"vectors of {' and '.join(map(str, sorted(sizes)))} components")
        return self._emit(name, function.run, fitted, function.gives)

    def _fit(self, value: Register, wish: str, node: ast.expr, function: Function) -> Register:
        if wish == "number":
            return self._number(value, node, function.signature)
        wanted = wish.removeprefix("vector")
        if not value.kind.size or (wanted and value.kind.size != int(wanted)):
            taken = f"{wanted}-vector" if wanted else wish
            raise refuse(node, f"{value.kind}, where {function.signature} takes a {taken}")
        return value

    def _component(self, node: ast.Call) -> Register:
        value, index = self._value(node.args[0]), literal(node.args[1])
        size = value.kind.size
        if not size:
            raise refuse(node.args[0], f"{value.kind} has no components")
        if index is None or index != int(index) or not 0 <= index < size:
            raise refuse(node.args[1], f"the index is one of 0 to {size - 1}, written out")
        run = partial(component, index=int(index))
        return self._emit(("component", int(index)), run, [value], NUMBER)

    # Registers.

    def _constant(self, value: bool | float) -> Register:
        """A number or a truth value that is written out."""
        key = (type(value), value)
        if key not in self._known:
            truth = isinstance(value, bool)
            tensor = torch.tensor(value, dtype=torch.bool if truth else torch.float64)
            self._known[key] = Register(self._new(tensor), TRUTH if truth else NUMBER)
        return self._known[key]

    def _emit(
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
        if (key, indices) not in self._known:
            constants = [self._registers[index] for index in indices]
            if any(constant is None for constant in constants):
                out = self._new(None)
                self._steps.append(Step(run, indices, out))
            else:
                out = self._new(run(*constants))
            self._known[key, indices] = Register(out, kind)
        return self._known[key, indices]

    def _number(self, register: Register, node: ast.AST, what: str) -> Register:
        """A number as it is; a truth value as 0 or 1. A vector is refused."""
        if register.kind.size:
            raise refuse(node, f"{register.kind}, where {what} takes a number")
        if register.kind == NUMBER:
            return register
        return self._emit("number", Tensor.double, [register], NUMBER)

    def _truth(self, register: Register, node: ast.AST, what: str) -> Register:
        """A truth value as it is. Anything else is refused."""
        if register.kind != TRUTH:
            raise refuse(node, f"{register.kind}, where {what} takes a truth value, such as a < b")
        return register

    def _choose(
        self, node: ast.AST, what: str, condition: Register, a: Register, b: Register
    ) -> Register:
        """``a`` in the environments where the condition holds, else ``b``."""
        if a.kind != b.kind:
            if a.kind.size or b.kind.size:
                raise refuse(node, f"{what} is {a.kind} or {b.kind}; it must be of one kind")
            a, b = self._number(a, node, what), self._number(b, node, what)
        run = _choose_vector if a.kind.size else torch.where
        return self._emit("where", run, [condition, a, b], a.kind)

    def _new(self, tensor: Tensor | None) -> int:
        self._registers.append(tensor)
        return len(self._registers) - 1


def _scaled(run: Callable[..., Tensor], vector: Tensor, number: Tensor) -> Tensor:
    """``run`` of vectors ``(n, k)``, each with its number ``(n,)``."""
    return run(vector, number.unsqueeze(-1))


def _choose_vector(condition: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """``where`` for vectors ``(n, k)``."""
    return torch.where(condition.unsqueeze(-1), a, b)


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
    wanted, given = len(function.takes), len(node.args)
    if given < wanted or (given > wanted and "..." not in function.signature):
        raise refuse(node, f"{given} arguments; {function.signature}")
    return name, function
