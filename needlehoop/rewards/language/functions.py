"""What a reward program may compute: operations on values, and functions.

Values are tensors: numbers ``(n,)`` float64, truth values ``(n,)`` bool, k-vectors ``(n, k)``
float64. ``n`` is 1 for what is always the same.
"""

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


class ProgramError(ValueError):
    """A refused program, and why; ``line`` and ``column`` count from 1."""

    def __init__(self, line: int, column: int, reason: str):
        super().__init__(line, column, reason)
        self.line, self.column, self.reason = line, column, reason

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.reason}"


def refuse(node: ast.AST, reason: str) -> ProgramError:
    """The error for a node that is not as it must be, at its place."""
    return ProgramError(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, reason)


def foreign(node: ast.AST, part: ast.AST) -> ProgramError:
    """The error for a part of a node that the language does not have."""
    return refuse(node, f"{type(part).__name__} is not in the language")


def size_of(value: Tensor) -> int:
    """The length of a vector ``(n, k)``; 0 for a number or a truth value ``(n,)``."""
    return value.shape[1] if value.ndim == 2 else 0


def kind_of(value: Tensor) -> str:
    if value.ndim == 2:
        return f"a {size_of(value)}-vector"
    return "a truth value" if value.dtype == torch.bool else "a number"


def fit(value: Tensor, node: ast.AST, wish: str = "number") -> Tensor:
    """A value as a ``number`` (a truth value is 0 or 1), ``vector``, ``vector3`` or ``vector4``."""
    size = size_of(value)
    if wish == "number" and not size:
        return value.double()
    if size and wish in ("vector", f"vector{size}"):
        return value
    raise refuse(node, f"{kind_of(value)}, where a {wish} is needed")


def compare(node: ast.Compare, ops: list[ast.cmpop], values: list[Tensor]) -> Tensor:
    """``a < b < c`` is ``a < b and b < c``."""
    truths = []
    for op, a, b in zip(ops, values, values[1:], strict=False):
        if type(op) not in COMPARISONS:
            raise foreign(node, op)
        truths.append(COMPARISONS[type(op)](a, b))
    return reduce(torch.logical_and, truths)


def arithmetic(node: ast.AST, op: ast.operator, a: Tensor, b: Tensor) -> Tensor:
    run = ARITHMETIC.get(type(op))
    if run is None:
        raise foreign(node, op)
    if not size_of(a) and not size_of(b):
        return run(fit(a, node), fit(b, node))
    if size_of(a) == size_of(b) and run in (torch.add, torch.sub):
        return run(a, b)
    if run is torch.mul and not size_of(a):
        a, b = b, a
    if run in (torch.mul, torch.div) and not size_of(b):
        return run(a, fit(b, node).unsqueeze(-1))
    raise refuse(node, f"{type(op).__name__} of {kind_of(a)} and {kind_of(b)}")


def choose(node: ast.AST, condition: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """``a`` in the environments where the condition holds, else ``b``."""
    if kind_of(a) != kind_of(b):
        if size_of(a) or size_of(b):
            raise refuse(node, f"either {kind_of(a)} or {kind_of(b)}; it must be of one kind")
        a, b = fit(a, node), fit(b, node)
    return torch.where(condition.unsqueeze(-1) if size_of(a) else condition, a, b)


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


def _vector(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.stack(torch.broadcast_tensors(a, b, c), -1)


_N, _V, _V3 = "number", "vector", "vector3"
_X, _Y, _Z = (itemgetter((..., index)) for index in range(3))
_COMPONENT = "component of any vector; i is written out and counts from 0"
_CHOSEN = "a where the condition holds, else b"
_CLIPPED = "a, but no less than low and no more than high"
_TURNED = "3-vector v turned by quaternion q (w, x, y, z)"
_ROWS = (
    Function("distance(u, v)", "Euclidean distance", (_V, _V), geo.distance),
    Function("norm(v)", "length of a vector", (_V,), lambda v: torch.sqrt(geo.dot(v, v))),
    Function("dot(u, v)", "scalar product", (_V, _V), geo.dot),
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
    Function("min(a, b, ...)", "the least", (_N, _N), lambda *all_: reduce(torch.minimum, all_)),
    Function("max(a, b, ...)", "the greatest", (_N, _N), lambda *all_: reduce(torch.maximum, all_)),
    Function("where(condition, a, b)", _CHOSEN, ("truth", "any", "any"), torch.where),
)
FUNCTIONS = {row.signature.partition("(")[0]: row for row in _ROWS}
