"""The nodes of a parsed program: refused where they stand, and read where they are plain."""

from __future__ import annotations

import ast

from needlehoop.rewards.language.grammar import ProgramError

_CALLED = {
    ast.Expr: "a statement that assigns nothing is",
    ast.AnnAssign: "annotations are",
    ast.Tuple: "tuples are",
    ast.NamedExpr: "assignment inside an expression is",
}


def refuse(node: ast.AST, reason: str) -> ProgramError:
    """The error for a node that can't be compiled, at its place."""
    return ProgramError(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, reason)


def foreign(node: ast.AST) -> ProgramError:
    """The error for a kind of node that the language does not have."""
    called = _CALLED.get(type(node), f"{type(node).__name__} is")
    return refuse(node, f"{called} not in the language")


def literal(node: ast.expr) -> float | None:
    """A number that is written out, with its sign; ``None`` for anything else."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            value = literal(operand)
            return None if value is None else -value
        case ast.Constant(value=bool()):
            return None
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case _:
            return None


def summed(node: ast.expr) -> list[str]:
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
