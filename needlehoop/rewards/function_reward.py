"""Rewards that are Python functions from outside the package.

``function(signals, **values)`` returns named terms, or one tensor. It is given as an object, or by
a name: ``module:name`` or ``file.py:name``.

Importing a name runs code. Only ``with_function`` and ``with_trusted_function`` import, and they
put the function itself into the config. ``load`` takes that function and never a name, so a config
that was read from a file cannot run anything.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import TYPE_CHECKING, Any

from torch import Tensor

from needlehoop.config.strict import shown, structure
from needlehoop.rewards.terms import RewardError, check_finite

if TYPE_CHECKING:
    from needlehoop.scene.signals import Signals

KIND = "python"
"""The kind of a reward that names its function."""

CALL = "call"
"""Key of an allowed config: the function in use. No file can hold one."""


@dataclass(frozen=True)
class _Config:
    kind: str
    function: str
    values: Mapping[str, Any] | None
    source: Any


@dataclass(frozen=True)
class FunctionReward:
    """A function in use, its keyword arguments, and the name that it was given by."""

    function: Callable[..., Any]
    values: Mapping[str, Any]
    origin: str

    def __call__(self, signals: Signals) -> dict[str, Tensor]:
        """Terms ``(n,)`` float64 by name; a single tensor is the term ``reward``.

        ``RewardError``: the function returned something else, or a term is not finite.
        """
        result = self.function(signals, **self.values)
        terms = {"reward": result} if isinstance(result, Tensor) else result
        if not isinstance(terms, Mapping) or not terms:
            raise RewardError(f"reward: {self.origin} returned {result!r}; expected named terms")
        n = len(signals)
        for name, term in terms.items():
            shape = tuple(term.shape) if isinstance(term, Tensor) else type(term).__name__
            if shape != (n,):
                raise RewardError(
                    f"reward: term {name!r} of {self.origin} is {shape}; expected a tensor ({n},)"
                )
        check_finite(terms, self.origin)
        return {str(name): term.double() for name, term in terms.items()}

    def text(self) -> str:
        """For the record: the function's origin, its values and its source."""
        return f"# {self.origin}, {dict(self.values)}\n{_source(self.function)}"


def given(function: Callable[..., Any]) -> dict[str, Any]:
    """The config of a function object. It can't be passed on to another process."""
    name = getattr(function, "__qualname__", type(function).__name__)
    call = FunctionReward(function, {}, name)
    return {"kind": KIND, "function": name, "values": {}, "source": None, CALL: call}


def check(config: Mapping[str, Any]) -> None:
    """Check the keys of a config that names code; imports nothing. Raises ``ValueError``."""
    values = {key: value for key, value in config.items() if key not in ("name", CALL)}
    structure(values, _Config, "reward")


def with_function(config: Mapping[str, Any]) -> dict[str, Any]:
    """The config of a reward that somebody typed, ready for ``load``: imports what it names.

    ``ValueError``: missing or unknown values, no such function, or one whose text has changed since
    the run began.
    """
    if config["kind"] != KIND or CALL in config:
        return dict(config)
    check(config)
    name = config["function"]
    function = _find(name)
    if config["source"] not in (None, _source(function)):
        raise ValueError(f"reward.function: {name} is no longer what the run began with")
    return {**config, CALL: FunctionReward(function, config["values"] or {}, name)}


def with_trusted_function(config: Mapping[str, Any], trust: bool) -> dict[str, Any]:
    """The config of a reward from a run's files, ready for ``load``: imports what it names.

    ``ValueError``: it names a function without ``trust``, or without a source to compare it with;
    else as in ``with_function``.
    """
    if config["kind"] == KIND:
        if not trust:
            raise _untrusted(config)
        if config.get("source") is None:
            raise ValueError("reward.source: null; a run notes the source of its function")
    return with_function(config)


def with_source(config: Mapping[str, Any]) -> dict[str, Any]:
    """A config that names code, with the function's source; errors as in ``with_function``."""
    reward, name = load(with_function(config)), config["function"]
    file, _, function = name.rpartition(":")
    if file.endswith(".py"):
        name = f"{Path(file).resolve()}:{function}"
    return {**config, "function": name, "source": _source(reward.function)}


def load(config: Mapping[str, Any]) -> FunctionReward:
    """The reward of a config that holds its function; ``ValueError`` for any other."""
    call = config.get(CALL)
    if not isinstance(call, FunctionReward):
        raise _untrusted(config)
    return call


def _untrusted(config: Mapping[str, Any]) -> ValueError:
    return ValueError(
        f"reward: the run's files name Python code, {shown(config.get('function'))}, which would be"
        " imported and run; add trust=true if you trust them"
    )


def _find(name: str) -> Callable[..., Any]:
    """The function that ``module:name`` or ``file.py:name`` names."""
    where, separator, attribute = name.rpartition(":")
    if not separator:
        raise ValueError(f"reward.function: {name!r} is not module:name or file.py:name")
    try:
        if where.endswith(".py"):
            function = run_path(str(Path(where).resolve())).get(attribute)
        else:
            function = getattr(import_module(where), attribute, None)
    except (ImportError, OSError) as error:
        raise ValueError(f"reward.function: {where!r}: {error}") from error
    if not callable(function):
        raise ValueError(f"reward.function: {where!r} has no function {attribute!r}")
    return function


def _source(function: Callable[..., Any]) -> str:
    """A function's text, or its ``repr``: a function typed at a prompt has no text."""
    thing = function if inspect.isroutine(function) or inspect.isclass(function) else type(function)
    try:
        return inspect.getsource(thing)
    except (OSError, TypeError):
        return f"{function!r}\n"
