"""The variables of a program, and what an if leaves of them."""

from __future__ import annotations

import ast
from typing import NamedTuple

from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.rewards.language.tape import Tape, Value
from needlehoop.rewards.language.tree import refuse
from needlehoop.scene.vocabulary import TABLE


class Partial(NamedTuple):
    """A variable that only one branch of an if, on ``line``, assigns."""

    line: int


Variables = dict[str, Value | Partial]


class Scope:
    """Values by the names of variables.

    Args:
        tape: on which the merging of branches is written.
    """

    def __init__(self, tape: Tape):
        self._tape = tape
        self.variables: Variables = {}

    def get(self, node: ast.expr, name: str) -> Value | None:
        """A variable's value; ``None`` for a name that is no variable.

        Raises:
            ProgramError: it has a value in only one branch of an earlier if.
        """
        found = self.variables.get(name)
        if isinstance(found, Partial):
            raise refuse(
                node,
                f"{name!r} has no value yet where the if on line {found.line} goes the other"
                " way; assign it before, or in every branch",
            )
        return found

    def set(self, target: ast.Name, value: Value) -> None:
        """Assign a variable.

        Raises:
            ProgramError: the name is a signal's or a function's.
        """
        for table, what in ((TABLE, "signal"), (FUNCTIONS, "function")):
            if target.id in table:
                raise refuse(target, f"{target.id!r} is a {what}; choose another name")
        self.variables[target.id] = value

    def merge(self, statement: ast.If, condition: Value, then: Variables, other: Variables) -> None:
        """Make the variables of an if's two branches one, environment by environment.

        Raises:
            ProgramError: a variable is of different kinds in them.
        """
        self.variables = {
            name: self._merged(statement, name, condition, then.get(name), other.get(name))
            for name in {**then, **other}
        }

    def _merged(
        self,
        statement: ast.If,
        name: str,
        condition: Value,
        then: Value | Partial | None,
        other: Value | Partial | None,
    ) -> Value | Partial:
        if isinstance(then, Value) and isinstance(other, Value):
            if then == other:
                return then
            what = f"{name!r} after the if"
            return self._tape.choose(statement, what, condition, then, other)
        if isinstance(then, Partial):
            return then
        return other if isinstance(other, Partial) else Partial(statement.lineno)
