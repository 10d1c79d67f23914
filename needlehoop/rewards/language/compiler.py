"""From a program's tree to its code, statement by statement.

The tree is walked once. Every expression becomes a step that writes one register; an
``if`` becomes both branches and a ``where`` for each variable that they leave different.
Nothing that a program says is ever run as Python.
"""

from __future__ import annotations

import ast

from needlehoop.rewards.language.code import Code
from needlehoop.rewards.language.expressions import Expressions
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.scope import Partial, Scope
from needlehoop.rewards.language.tape import Tape, Value
from needlehoop.rewards.language.tree import foreign, refuse, summed

MAX_STATEMENTS = 100
"""Statements in a program, those inside ifs included."""
MAX_NESTING = 16
"""Ifs inside each other, ``elif`` included."""

RESULT = "reward"
"""The variable that holds a program's value."""


def compile_tree(tree: ast.Module) -> Code:
    """The code of a parsed program.

    Raises:
        ProgramError: what is not in the language, does not fit together or is too much.
    """
    return _Compiler().compile(tree)


class _Compiler:
    def __init__(self):
        self._tape = Tape()
        self._scope = Scope(self._tape)
        self._expressions = Expressions(self._tape, self._scope)
        self._statements = self._nesting = 0
        self._last: tuple[ast.stmt, dict[str, Value]] | None = None
        """The last assignment to the result, and the terms it is the sum of."""

    def compile(self, tree: ast.Module) -> Code:
        self._block(tree.body)
        found = self._scope.variables.get(RESULT)
        if not isinstance(found, Value):
            end = tree.body[-1].end_lineno if tree.body else None
            some = " in only one branch of an if" if isinstance(found, Partial) else " nowhere"
            raise ProgramError(
                end or 1, 1, f"{RESULT!r} is assigned{some}; a program's value is that variable"
            )
        assert self._last is not None
        last, terms = self._last
        terms = terms or {RESULT: found}
        return self._tape.code({n: self._tape.number(v, last, n) for n, v in terms.items()})

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statements += 1
            if self._statements > MAX_STATEMENTS:
                raise refuse(statement, f"a program has at most {MAX_STATEMENTS} statements")
            match statement:
                case ast.Assign(targets=[ast.Name() as target], value=value):
                    self._assign(statement, target, value)
                case ast.Assign():
                    raise refuse(statement, "an assignment has one name on its left")
                case ast.AugAssign(target=ast.Name() as target, op=op, value=value):
                    old = self._expressions.name(target, target.id)
                    by = self._expressions.value(value)
                    changed = self._expressions.arithmetic(statement, op, old, by)
                    self._set(statement, target, changed)
                case ast.If():
                    self._if(statement)
                case _:
                    raise foreign(statement)

    def _assign(self, statement: ast.stmt, target: ast.Name, expression: ast.expr) -> None:
        value = self._expressions.value(expression)
        names = summed(expression)
        terms: dict[str, Value] = {}
        if target.id == RESULT and not self._nesting:
            distinct = len(set(names)) == len(names)
            if names and distinct and RESULT not in names:
                terms = {name: self._expressions.name(expression, name) for name in names}
        self._set(statement, target, value, terms)

    def _set(
        self,
        statement: ast.stmt,
        target: ast.Name,
        value: Value,
        terms: dict[str, Value] | None = None,
    ) -> None:
        self._scope.set(target, value)
        if target.id == RESULT:
            self._last = statement, terms or {}

    def _if(self, statement: ast.If) -> None:
        condition = self._expressions.condition(statement.test)
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise refuse(statement, f"more than {MAX_NESTING} ifs inside each other")
        scope = self._scope
        before = scope.variables
        scope.variables = dict(before)
        self._block(statement.body)
        then, scope.variables = scope.variables, dict(before)
        self._block(statement.orelse)
        self._nesting -= 1
        scope.merge(statement, condition, then, scope.variables)
