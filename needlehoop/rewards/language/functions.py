"""What a reward program may compute: operators and functions."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import reduce
from operator import itemgetter
from typing import NamedTuple

import torch
from torch import Tensor

from needlehoop.robot import geometry as geo

ARITHMETIC: dict[type[ast.operator], Callable[..., Tensor]] = {
    ast.Add: torch.add,
    ast.Sub: torch.sub,
    ast.Mult: torch.mul,
    ast.Div: torch.div,
}
COMPARISONS: dict[type[ast.cmpop], Callable[..., Tensor]] = {
    ast.Lt: torch.lt,
    ast.LtE: torch.le,
    ast.Gt: torch.gt,
    ast.GtE: torch.ge,
    ast.Eq: torch.eq,
    ast.NotEq: torch.ne,
}
JUNCTIONS: dict[type[ast.boolop], Callable[..., Tensor]] = {
    ast.And: torch.logical_and,
    ast.Or: torch.logical_or,
}


class Function(NamedTuple):
    """One row of the table of functions.

    ``takes`` names each argument's kind: ``number``; ``vector`` (all of one length); ``vector3``;
    ``vector4``. The last one may be repeated if the signature has dots. ``run`` takes numbers
    ``(n,)`` and vectors ``(n, k)``. The compiler itself handles ``component`` and ``where``.
    """

    signature: str
    meaning: str
    takes: tuple[str, ...]
    run: Callable[..., Tensor]


def _dot(a: Tensor, b: Tensor) -> Tensor:
    # One component after the other: a row of a batch gets the same bits as it would alone.
    return reduce(torch.add, (a * b).unbind(-1))


def _norm(v: Tensor) -> Tensor:
    return torch.sqrt(_dot(v, v))


def _vector(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.stack(torch.broadcast_tensors(a, b, c), -1)


def _least(*numbers: Tensor) -> Tensor:
    return reduce(torch.minimum, numbers)


def _greatest(*numbers: Tensor) -> Tensor:
    return reduce(torch.maximum, numbers)


_N, _V, _V3 = "number", "vector", "vector3"
_X, _Y, _Z = (itemgetter((..., index)) for index in range(3))
_COMPONENT = "component of any vector; i is written out and counts from 0"
_CHOSEN = "a where the condition holds, else b"
_CLIPPED = "a, but no less than low and no more than high"
_TURNED = "3-vector v turned by quaternion q (w, x, y, z)"
_ROWS = (
    Function("distance(u, v)", "Euclidean distance", (_V, _V), lambda u, v: _norm(u - v)),
    Function("norm(v)", "length of a vector", (_V,), _norm),
    Function("dot(u, v)", "scalar product", (_V, _V), _dot),
    Function("x(v)", "first component of a 3-vector", (_V3,), _X),
    Function("y(v)", "second component of a 3-vector", (_V3,), _Y),
    Function("z(v)", "third component of a 3-vector (up)", (_V3,), _Z),
    Function("component(v, i)", _COMPONENT, (_V, "index"), Tensor.__getitem__),
    Function("vector(a, b, c)", "a 3-vector", (_N, _N, _N), _vector),
    Function("rotate(q, v)", _TURNED, ("vector4", _V3), geo.rotate),
    Function("clip(a, low, high)", _CLIPPED, (_N, _N, _N), torch.clamp),
    Function("exp(a)", "e to the power of a", (_N,), torch.exp),
    Function("log(a)", "natural logarithm", (_N,), torch.log),
    Function("sqrt(a)", "square root", (_N,), torch.sqrt),
    Function("tanh(a)", "hyperbolic tangent", (_N,), torch.tanh),
    Function("abs(a)", "absolute value", (_N,), torch.abs),
    Function("min(a, b, ...)", "the least", (_N, _N), _least),
    Function("max(a, b, ...)", "the greatest", (_N, _N), _greatest),
    Function("where(condition, a, b)", _CHOSEN, ("truth", "any", "any"), torch.where),
)
FUNCTIONS = {row.signature.partition("(")[0]: row for row in _ROWS}
