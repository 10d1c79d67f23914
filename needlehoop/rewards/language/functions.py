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


def component(v: Tensor, index: int) -> Tensor:
    """One component of vectors ``(n, k)``."""
    return v[..., index]


class Function(NamedTuple):
    """One row of the table of functions.

    ``takes`` names each argument's kind: ``number``; ``truth``; ``vector`` (all of one length);
    ``vector3``; ``vector4``; ``any`` (all of one kind); ``index`` (a whole number, written out).
    The last one may be repeated if the signature ends with dots. A truth value counts as the
    number 0 or 1 where a number is taken. ``gives`` is the result's kind.
    """

    signature: str
    meaning: str
    takes: tuple[str, ...]
    run: Callable[..., Tensor]
    gives: Kind = NUMBER


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


_N, _V, _V3 = "number", "vector", "vector3"
_X, _Y, _Z = (partial(component, index=index) for index in range(3))
_ROWS = (
    Function("distance(u, v)", "Euclidean distance", (_V, _V), _distance),
    Function("norm(v)", "length of a vector", (_V,), _norm),
    Function("dot(u, v)", "scalar product", (_V, _V), _dot),
    Function("x(v)", "first component of a 3-vector", (_V3,), _X),
    Function("y(v)", "second component of a 3-vector", (_V3,), _Y),
    Function("z(v)", "third component of a 3-vector (up)", (_V3,), _Z),
    Function(
        "component(v, i)",
        "component of any vector; i is written out and counts from 0",
        (_V, "index"),
        component,
    ),
    Function("vector(a, b, c)", "a 3-vector", (_N, _N, _N), _vector, vector_of(3)),
    Function(
        "rotate(q, v)",
        "3-vector v turned by quaternion q (w, x, y, z)",
        ("vector4", _V3),
        geo.rotate,
        vector_of(3),
    ),
    Function(
        "clip(a, low, high)",
        "a, but no less than low and no more than high",
        (_N, _N, _N),
        torch.clamp,
    ),
    Function("exp(a)", "e to the power of a", (_N,), torch.exp),
    Function("log(a)", "natural logarithm", (_N,), torch.log),
    Function("sqrt(a)", "square root", (_N,), torch.sqrt),
    Function("tanh(a)", "hyperbolic tangent", (_N,), torch.tanh),
    Function("abs(a)", "absolute value", (_N,), torch.abs),
    Function("min(a, b, ...)", "the least", (_N, _N), _least),
    Function("max(a, b, ...)", "the greatest", (_N, _N), _greatest),
    Function(
        "where(condition, a, b)",
        "a where the condition holds, else b",
        ("truth", "any", "any"),
        torch.where,
    ),
)
FUNCTIONS = {row.signature.partition("(")[0]: row for row in _ROWS}
