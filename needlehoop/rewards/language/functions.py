"""What a reward program may compute: kinds of values, operators and functions."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial, reduce
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo


class Kind(NamedTuple):
    """What a value is: ``size`` 0 for a number or a truth value, else a vector's length."""

    name: str
    size: int = 0

    def __str__(self) -> str:
        return f"a {self.size}-vector" if self.size else f"a {self.name}"


NUMBER, TRUTH = Kind("number"), Kind("truth value")


def vector_of(size: int) -> Kind:
    """The kind of vectors of that length."""
    return Kind("vector", size)


Operator = tuple[str, Callable[..., Tensor]]
"""A sign and what it does."""

ARITHMETIC: dict[type[ast.operator], Operator] = {
    ast.Add: ("+", torch.add),
    ast.Sub: ("-", torch.sub),
    ast.Mult: ("*", torch.mul),
    ast.Div: ("/", torch.div),
}
COMPARISONS: dict[type[ast.cmpop], Operator] = {
    ast.Lt: ("<", torch.lt),
    ast.LtE: ("<=", torch.le),
    ast.Gt: (">", torch.gt),
    ast.GtE: (">=", torch.ge),
    ast.Eq: ("==", torch.eq),
    ast.NotEq: ("!=", torch.ne),
}
JUNCTIONS: dict[type[ast.boolop], Operator] = {
    ast.And: ("and", torch.logical_and),
    ast.Or: ("or", torch.logical_or),
}


def times(vector: Tensor, number: Tensor) -> Tensor:
    """Vectors ``(n, k)``, each multiplied by its number ``(n,)``."""
    return vector * number.unsqueeze(-1)


def over(vector: Tensor, number: Tensor) -> Tensor:
    """Vectors ``(n, k)``, each divided by its number ``(n,)``."""
    return vector / number.unsqueeze(-1)


def choose_vector(condition: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """``where`` for vectors ``(n, k)``."""
    return torch.where(condition.unsqueeze(-1), a, b)


def component(v: Tensor, index: int) -> Tensor:
    """One component of vectors ``(n, k)``."""
    return v[..., index]


class Function(NamedTuple):
    """One row of the table of functions.

    ``takes`` names each argument's kind: ``number``; ``truth``; ``vector`` (all of one length);
    ``vector3``; ``vector4``; ``any`` (all of one kind); ``index`` (a whole number, written out).
    ``gives`` is the result's kind. With ``more`` the last argument may be repeated. A truth
    value counts as the number 0 or 1 where a number is taken.
    """

    signature: str
    meaning: str
    takes: tuple[str, ...]
    gives: str
    run: Callable[..., Tensor]
    more: bool = False


def _dot(a: Tensor, b: Tensor) -> Tensor:
    # One component after the other: a row of a batch gets the same bits as it would alone.
    return reduce(torch.add, (a * b).unbind(-1))


def _norm(v: Tensor) -> Tensor:
    return torch.sqrt(_dot(v, v))


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return _norm(a - b)


def _vector(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.stack(torch.broadcast_tensors(a, b, c), -1)


def _least(*values: Tensor) -> Tensor:
    return reduce(torch.minimum, values)


def _greatest(*values: Tensor) -> Tensor:
    return reduce(torch.maximum, values)


def _coordinate(name: str, meaning: str, index: int) -> Function:
    run = partial(component, index=index)
    return Function(f"{name}(v)", meaning, ("vector3",), "number", run)


def _unary(name: str, meaning: str, run: Callable[[Tensor], Tensor]) -> Function:
    return Function(f"{name}(a)", meaning, ("number",), "number", run)


FUNCTIONS: dict[str, Function] = {
    "distance": Function(
        "distance(u, v)", "Euclidean distance", ("vector", "vector"), "number", _distance
    ),
    "norm": Function("norm(v)", "length of a vector", ("vector",), "number", _norm),
    "dot": Function("dot(u, v)", "scalar product", ("vector", "vector"), "number", _dot),
    "x": _coordinate("x", "first component of a 3-vector", 0),
    "y": _coordinate("y", "second component of a 3-vector", 1),
    "z": _coordinate("z", "third component of a 3-vector (up)", 2),
    "component": Function(
        "component(v, i)",
        "component of any vector; i is written out and counts from 0",
        ("vector", "index"),
        "number",
        component,
    ),
    "vector": Function(
        "vector(a, b, c)", "a 3-vector", ("number", "number", "number"), "vector3", _vector
    ),
    "rotate": Function(
        "rotate(q, v)",
        "3-vector v turned by quaternion q (w, x, y, z)",
        ("vector4", "vector3"),
        "vector3",
        geo.rotate,
    ),
    "clip": Function(
        "clip(a, low, high)",
        "a, but no less than low and no more than high",
        ("number", "number", "number"),
        "number",
        torch.clamp,
    ),
    "exp": _unary("exp", "e to the power of a", torch.exp),
    "log": _unary("log", "natural logarithm", torch.log),
    "sqrt": _unary("sqrt", "square root", torch.sqrt),
    "tanh": _unary("tanh", "hyperbolic tangent", torch.tanh),
    "abs": _unary("abs", "absolute value", torch.abs),
    "min": Function(
        "min(a, b, ...)", "the least", ("number", "number"), "number", _least, more=True
    ),
    "max": Function(
        "max(a, b, ...)", "the greatest", ("number", "number"), "number", _greatest, more=True
    ),
    "where": Function(
        "where(condition, a, b)",
        "a where the condition holds, else b",
        ("truth", "any", "any"),
        "any",
        torch.where,
    ),
}
