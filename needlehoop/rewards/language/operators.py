"""The operators of the language, and the torch calls that they are."""

from __future__ import annotations

import ast
from collections.abc import Callable

import torch
from torch import Tensor

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
