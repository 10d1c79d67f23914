"""From a program's text to its tree, by way of a list of allowed tokens.

Tokens are checked before Python's parser sees the text. So the parser never meets a string, an
attribute or a subscript. The number of tokens is bounded, so the parser never recurses deeply.
"""

from __future__ import annotations

import ast
import keyword
import re

MAX_SOURCE = 10_000
"""Characters in a program."""
MAX_TOKENS = 300
"""Tokens in one statement."""
MAX_BRACKETS = 20
"""Brackets inside brackets."""
MAX_INDENT = 64
"""Spaces before a statement."""
MAX_NAME = 40
"""Characters in a name."""
MAX_DIGITS = 24
"""Characters in a number."""
MAX_CONSTANT = 1e6
"""The largest number that may be written."""

WORDS = ("if", "elif", "else", "and", "or", "not", "True", "False")
"""Python's keywords that are in the language."""

_TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<operator>\*\*|[<>=!]=|[-+*/]=|[-+*/<>=(),:])"
    r"|(?P<comment>#[ -~]*)"
    r"|(?P<space> +)"
    r"|(?P<newline>\n)"
    r"|(?P<foreign>.)",
    re.ASCII | re.DOTALL,
)

_NOT_HERE = {
    ".": "attributes are not in the language",
    "[": "subscripts and lists are not in the language; x(v), y(v), z(v) and component(v, i)"
    " read a vector",
    "{": "dictionaries and sets are not in the language",
    "'": "strings are not in the language",
    '"': "strings are not in the language",
    "@": "decorators and matrix products are not in the language",
    ";": "one statement per line",
    "\\": "a backslash is not in the language; a statement goes on inside brackets",
    "&": "& is not in the language; write `and`",
    "|": "| is not in the language; write `or`",
    "~": "~ is not in the language; write `not`",
    "\t": "a tab; indent with spaces",
    "\r": "a carriage return; end lines with a line feed",
}


_KINDS_OF_NODES = {
    ast.Expr: "a statement that assigns nothing is",
    ast.AnnAssign: "annotations are",
    ast.Tuple: "tuples are",
    ast.NamedExpr: "assignment inside an expression is",
}
"""How a refusal names some kinds of nodes."""


class ProgramError(ValueError):
    """A refused program: why, and what would do; ``line`` and ``column`` count from 1."""

    def __init__(self, line: int, column: int, reason: str):
        super().__init__(line, column, reason)
        self.line, self.column, self.reason = line, column, reason

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: {self.reason}"


def parse(source: str) -> ast.Module:
    """A program's tree; ``ProgramError`` for a foreign token, too much of one, or no Python."""
    if len(source) > MAX_SOURCE:
        raise ProgramError(1, 1, f"{len(source)} characters; a program has at most {MAX_SOURCE}")
    _check_tokens(source)
    try:
        return ast.parse(source)
    except SyntaxError as error:
        line, column = error.lineno or 1, max(1, error.offset or 1)
        raise ProgramError(line, column, f"not Python: {error.msg}") from error


def _check_tokens(source: str) -> None:
    """Raises ``ProgramError`` for a token that is not in the language, or too many of them."""
    line, line_start, brackets, tokens = 1, 0, 0, 0
    for found in _TOKEN.finditer(source):
        kind, text, reason = found.lastgroup, found.group(), None
        if kind == "newline":
            line, line_start = line + 1, found.end()
            tokens = tokens if brackets else 0
        elif kind == "space":
            if found.start() == line_start and len(text) > MAX_INDENT:
                reason = f"indented by {len(text)} spaces; at most {MAX_INDENT}"
        elif kind == "foreign":
            reason = _foreign(text)
        elif kind != "comment":
            tokens += 1
            brackets = max(0, brackets + (text == "(") - (text == ")"))
            if tokens > MAX_TOKENS:
                reason = f"a statement has at most {MAX_TOKENS} tokens; split it up"
            elif brackets > MAX_BRACKETS:
                reason = f"more than {MAX_BRACKETS} brackets inside each other"
            else:
                reason = _unfit(kind, text, source[found.end() : found.end() + 1])
        if reason is not None:
            raise ProgramError(line, found.start() - line_start + 1, reason)


def _unfit(kind: str | None, text: str, following: str) -> str | None:
    """Why a number or a name is refused, if it is."""
    if kind == "number":
        if following and (following.isalnum() or following in "_."):
            return "not a number; write it as 12, 0.5 or 1e-3"
        if len(text) > MAX_DIGITS:
            return f"a number has at most {MAX_DIGITS} characters"
        if float(text) > MAX_CONSTANT:
            return f"{text} is too large; numbers go up to {MAX_CONSTANT:g}"
    elif kind == "name":
        if len(text) > MAX_NAME:
            return f"a name has at most {MAX_NAME} characters"
        if text.startswith("_"):
            return f"{text}: names begin with a letter"
        if keyword.iskeyword(text) and text not in WORDS:
            return f"{text!r} is not in the language; its words are {', '.join(WORDS)}"
    return None


def _foreign(character: str) -> str:
    if character in _NOT_HERE:
        return _NOT_HERE[character]
    coded = f"U+{ord(character):04X}"
    if not character.isascii():
        return f"{coded} is not an ASCII character"
    return f"{character if character.isprintable() else coded} is not in the language"


def refuse(node: ast.AST, reason: str) -> ProgramError:
    """The error for a node that can't be compiled, at its place."""
    return ProgramError(getattr(node, "lineno", 1), getattr(node, "col_offset", 0) + 1, reason)


def foreign(node: ast.AST) -> ProgramError:
    """The error for a kind of node that the language does not have."""
    called = _KINDS_OF_NODES.get(type(node), f"{type(node).__name__} is")
    return refuse(node, f"{called} not in the language")


def literal(node: ast.expr) -> float | None:
    """A number that is written out, with its sign; ``None`` for anything else."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            value = literal(operand)
            return None if value is None else -value
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
    return None


def summed(node: ast.expr) -> list[str]:
    """The names whose plain sum an expression is; none if it is anything else."""
    match node:
        case ast.BinOp(left=ast.Name(id=first), op=ast.Add(), right=ast.Name(id=last)):
            return [first, last]
        case ast.BinOp(left=left, op=ast.Add(), right=ast.Name(id=last)) if names := summed(left):
            return [*names, last]
    return []
