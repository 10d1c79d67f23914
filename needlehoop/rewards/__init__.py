"""Rewards: functions from signals to named terms. They never decide success.

The terms are summed to a potential, and each step pays the potential's difference. So an
episode's return is its last potential. Here rewards are loaded by name.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from needlehoop.config import strict
from needlehoop.config.strict import Real
from needlehoop.rewards import function_reward, program_reward
from needlehoop.rewards.function_reward import CALL, given, with_function, with_trusted_function
from needlehoop.rewards.terms import Reward, RewardError, Sparse, potential
from needlehoop.runs.files import EXPERT, check_name
from needlehoop.runs.reading import read_yaml
from needlehoop.tasks.contract import Task
from needlehoop.tasks.registry import conf_of

__all__ = [
    "CALL",
    "Reward",
    "RewardError",
    "given",
    "potential",
    "with_function",
    "with_trusted_function",
]

_KINDS = ("human", "sparse", *program_reward.KINDS, function_reward.KIND)

NONE = {"kind": "sparse", "success": 1.0}
"""The config of a reward for environments whose reward nobody reads."""


@dataclass(frozen=True)
class _Sparse:
    success: Real


def load(config: Mapping[str, Any], task: Task) -> Reward:
    """A reward from its config: ``kind``, the values of that kind, and maybe a ``name``.

    ``ValueError``: an unknown kind, invalid values or name, or Python code that was not allowed.
    """
    _check_kind(config)
    if config["kind"] == function_reward.KIND:
        return function_reward.load(config)
    if config["kind"] in program_reward.KINDS:
        return program_reward.load(config, task.signals)
    values = {key: value for key, value in config.items() if key not in ("kind", "name")}
    if config["kind"] == "sparse":
        return Sparse(strict.structure(values, _Sparse, "reward").success, task.goal)
    return strict.structure(values, task.human, "reward")


def reference_reward(task: Task) -> Reward:
    """A task's human reward with its default values. All policies are compared by its return."""
    return load(read_yaml(conf_of(task.name) / f"reward/human/{task.name}.yaml"), task)


def check(config: Mapping[str, Any], task: Task) -> None:
    """Check a reward's config without running its code. Errors as in ``load``."""
    _check_kind(config)
    if config["kind"] == function_reward.KIND:
        function_reward.check(config)
    else:
        load(config, task)


def with_source(config: Mapping[str, Any]) -> dict[str, Any]:
    """A config with its program's or function's text, for a run to keep; errors as in ``load``."""
    if config["kind"] == function_reward.KIND:
        return function_reward.with_source(config)
    if config["kind"] in program_reward.KINDS:
        return program_reward.with_source(config)
    return dict(config)


def text(reward: Reward) -> str:
    """A reward for the record: its values or its origin, then its source."""
    if isinstance(reward, program_reward.ProgramReward | function_reward.FunctionReward):
        return reward.text()
    return f"{reward!r}\n\n{inspect.getsource(type(reward))}"


def _check_kind(config: Mapping[str, Any]) -> None:
    kind: Any = config.get("kind")
    strict.check_names("reward.kind", [kind], _KINDS)
    # A run's folder is called by its reward's name.
    name = strict.structure(config.get("name"), str | None, "reward.name")
    if name is not None:
        check_name("reward.name", name)
        if name in {*_KINDS, EXPERT} - {kind}:
            raise ValueError(
                f"reward.name: {name!r} means another reward; choose a name of your own"
            )
