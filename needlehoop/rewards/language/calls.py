"""Calls of the language's functions: their arguments are counted and their kinds fitted."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial

from needlehoop.rewards.language.functions import FUNCTIONS, NUMBER, Function, component, vector_of
from needlehoop.rewards.language.tape import Tape, Value
from needlehoop.rewards.language.tree import literal, refuse

_SPOKEN = {"vector": "vector", "vector3": "3-vector", "vector4": "4-vector"}


class Calls:
    """Writes calls on a tape.

    Args:
        tape: where.
        value: writes an argument.
    """

    def __init__(self, tape: Tape, value: Callable[[ast.expr], Value]):
        self._tape, self._value = tape, value

    def call(self, node: ast.Call) -> Value:
        """A call's result.

        Raises:
            ProgramError: no such function, or arguments that it does not take.
        """
        name, function = _function(node)
        if function.takes[-1] == "index":
            return self._component(node)
        values = [self._value(argument) for argument in node.args]
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

    def _fit(self, value: Value, wish: str, node: ast.expr, function: Function) -> Value:
        if wish == "number":
            return self._tape.number(value, node, function.signature)
        sizes = {"vector3": (3,), "vector4": (4,)}.get(wish)
        if not value.kind.size or (sizes and value.kind.size not in sizes):
            raise refuse(node, f"{value.kind}, where {function.signature} takes a {_SPOKEN[wish]}")
        return value

    def _component(self, node: ast.Call) -> Value:
        value = self._value(node.args[0])
        index = literal(node.args[1])
        size = value.kind.size
        if not size:
            raise refuse(node.args[0], f"{value.kind} has no components")
        if index is None or index != int(index) or not 0 <= index < size:
            raise refuse(node.args[1], f"the index is one of 0 to {size - 1}, written out")
        run = partial(component, index=int(index))
        return self._tape.emit(("component", int(index)), run, [value], NUMBER)


def _function(node: ast.Call) -> tuple[str, Function]:
    """Name and row of the function that is called, with as many arguments as it takes."""
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
