"""From a program's text to Python's syntax tree, and what can be read off the tree alone.

The tree is never run as Python. ``program`` knows a few kinds of nodes and refuses the rest. The
length of the text bounds the time and memory of Python's parser.
"""

from __future__ import annotations

import ast

MAX_SOURCE = 10_000
"""Characters in a program."""
MAX_CONSTANT = 1e6
"""The largest number that may be written."""


class ProgramError(ValueError):
    """A refused program, and why; ``line`` and ``column`` count from 1."""

    def __init__(self, line: int, column: int, reason: str):
        super().__init__(line, column, reason)
        self.line, self.column, self.reason = line, column, reason

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.reason}"


def parse(source: str) -> ast.Module:
    """A program's tree; ``ProgramError`` if it is too long, not ASCII, or not Python."""
    if len(source) > MAX_SOURCE:
        raise ProgramError(1, 1, f"{len(source)} characters; a program has at most {MAX_SOURCE}")
    if not source.isascii():
        letter = next(one for one in source if not one.isascii())
        before, _, _ = source.partition(letter)
        column = len(before.rpartition("\n")[2]) + 1
        raise ProgramError(before.count("\n") + 1, column, f"{letter!a} is not ASCII")
    try:
        return ast.parse(source)
    except SyntaxError as error:
        line, column = error.lineno or 1, max(1, error.offset or 1)
        raise ProgramError(line, column, f"not Python: {error.msg}") from error
    except (ValueError, MemoryError, RecursionError) as error:
        # A null character, or brackets and operators too deep inside each other.
        raise ProgramError(1, 1, f"not Python: {error or 'too deep'}") from error


def refuse(node: ast.AST, reason: str) -> ProgramError:
    """The error for a node that is not as it must be, at its place."""
    return ProgramError(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, reason)


def foreign(node: ast.AST) -> ProgramError:
    """The error for a kind of node that the language does not have."""
    return refuse(node, f"{type(node).__name__} is not in the language")


def literal(node: ast.expr) -> float | None:
    """A number that is written out, with its sign; ``None`` for anything else."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            value = literal(operand)
            return None if value is None else -value
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return value
    return None


def summed(node: ast.expr) -> list[str]:
    """The names whose plain sum an expression is; none if it is anything else."""
    match node:
        case ast.BinOp(left=ast.Name(id=first), op=ast.Add(), right=ast.Name(id=last)):
            return [first, last]
        case ast.BinOp(left=left, op=ast.Add(), right=ast.Name(id=last)) if names := summed(left):
            return [*names, last]
    return []
