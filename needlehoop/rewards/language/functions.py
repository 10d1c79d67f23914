"""What a reward program may compute: its kinds of values, and its functions."""

from __future__ import annotations

from collections.abc import Callable
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


class Function(NamedTuple):
    """One row of the table of functions.

    ``takes`` names each argument's kind: ``number``; ``truth``; ``vector`` (all of one
    length), ``vector3``, ``vector4``; ``any`` (all of one kind); ``index`` (a whole number,
    written out). ``gives`` is the result's. ``more``: the last argument may be repeated.
    Truth values count as numbers, 0 or 1, where numbers are taken.
    """

    signature: str
    meaning: str
    takes: tuple[str, ...]
    gives: str
    run: Callable[..., Tensor]
    more: bool = False


def _dot(a: Tensor, b: Tensor) -> Tensor:
    # Component by component, so that a row of a batch is what it is alone.
    first, *rest = (a * b).unbind(-1)
    for part in rest:
        first = first + part
    return first


def _norm(v: Tensor) -> Tensor:
    return torch.sqrt(_dot(v, v))


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return _norm(a - b)


def _vector(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    return torch.stack(torch.broadcast_tensors(a, b, c), -1)


def _least(*values: Tensor) -> Tensor:
    first, *rest = values
    for value in rest:
        first = torch.minimum(first, value)
    return first


def _greatest(*values: Tensor) -> Tensor:
    first, *rest = values
    for value in rest:
        first = torch.maximum(first, value)
    return first


def choose_vector(condition: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """``where`` for vectors."""
    return torch.where(condition.unsqueeze(-1), a, b)


def component(v: Tensor, index: int) -> Tensor:
    """One component of vectors."""
    return v[..., index]


def _x(v: Tensor) -> Tensor:
    return v[..., 0]


def _y(v: Tensor) -> Tensor:
    return v[..., 1]


def _z(v: Tensor) -> Tensor:
    return v[..., 2]


def _unary(name: str, meaning: str, run: Callable[[Tensor], Tensor]) -> Function:
    return Function(f"{name}(a)", meaning, ("number",), "number", run)


FUNCTIONS: dict[str, Function] = {
    "distance": Function(
        "distance(u, v)", "Euclidean distance", ("vector", "vector"), "number", _distance
    ),
    "norm": Function("norm(v)", "length of a vector", ("vector",), "number", _norm),
    "dot": Function("dot(u, v)", "scalar product", ("vector", "vector"), "number", _dot),
    "x": Function("x(v)", "first component of a 3-vector", ("vector3",), "number", _x),
    "y": Function("y(v)", "second component of a 3-vector", ("vector3",), "number", _y),
    "z": Function("z(v)", "third component of a 3-vector (up)", ("vector3",), "number", _z),
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


def describe_functions() -> str:
    """The functions as text, one per line: signature, meaning."""
    width = max(len(function.signature) for function in FUNCTIONS.values())
    return "\n".join(f"{f.signature.ljust(width)}  {f.meaning}" for f in FUNCTIONS.values())
