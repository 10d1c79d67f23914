"""Several PSMs as one robot.

An arm has a name, such as ``psm1``. All of it in the scene, the signals and the memory begins with
``psm1_``, and ``psm1`` of the layout, an ``ArmAside``, says where it stands. An action is that of
the first arm, then that of the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import mujoco
import numpy as np
import torch
from torch import Tensor

from needlehoop.robot.psm import poser
from needlehoop.scene.signals import Signal
from needlehoop.tasks import psm
from needlehoop.tasks.contract import Memory, Part, Robot
from needlehoop.tasks.psm import ROBOT
from needlehoop.tasks.start import Start

T = TypeVar("T")


def of_arm(name: str, values: Mapping[str, T]) -> dict[str, T]:
    """An arm's share of the values, under the names that a single arm's have."""
    prefix = f"{name}_"
    return {key.removeprefix(prefix): one for key, one in values.items() if key.startswith(prefix)}


def by_arm(arms: Mapping[str, Mapping[str, T]]) -> dict[str, T]:
    """The values of several arms, each under its arm's name."""
    return {f"{name}_{key}": one for name, arm in arms.items() for key, one in arm.items()}


def side_by_side(words: Mapping[str, str]) -> Robot:
    """A robot of PSMs, from their names and what they are called, such as ``PSM 1``."""
    names = tuple(words)

    def model(layout: Any, variant: str) -> mujoco.MjSpec:
        spec = mujoco.MjSpec()
        root = spec.worldbody.add_body(name="arms")
        for name in names:
            arm = psm.model(getattr(layout, name), variant)
            spec.attach(arm, prefix=f"{name}_", frame=root.add_frame())
        return spec

    def pose(model: mujoco.MjModel) -> Callable[[np.ndarray, Start], None]:
        puts = {name: poser(model, f"{name}_") for name in names}

        def write(qpos: np.ndarray, start: Start) -> None:
            for name, put in puts.items():
                robot = of_arm(name, start.robot)
                put(qpos, robot["joints"].numpy(), robot["jaw"].numpy())

        return write

    def begin(rules: Any, start: Start) -> dict[str, Tensor]:
        return by_arm({name: psm.begin(rules, of_arm(name, start.robot)) for name in names})

    def act(
        layout: Any, rules: Any, memory: Memory, action: Tensor
    ) -> tuple[dict[str, Tensor], Tensor]:
        moved, servos = {}, []
        for name, part in zip(names, action.chunk(len(names), -1), strict=True):
            arm = getattr(layout, name)
            moved[name], control = psm.act(arm, rules, of_arm(name, memory), part)
            servos.append(control)
        return by_arm(moved), torch.cat(servos, -1)

    def displaced(layout: Any, rules: Any, memory: Memory, offset: Tensor) -> Tensor:
        arms = [(getattr(layout, name), of_arm(name, memory)) for name in names]
        return torch.cat([psm.displaced(arm, rules, state, offset) for arm, state in arms], -1)

    def table(things: Mapping[str, Signal], held: str | None) -> dict[str, Signal]:
        single = ROBOT.table({}, held)
        arms = {
            name: {key: _of_one(row, name, word) for key, row in single.items()}
            for name, word in words.items()
        }
        return {**things, **by_arm(arms)}

    parts = {
        name: {
            body: Part(f"{part.name} of {word}", part.along) for body, part in ROBOT.parts.items()
        }
        for name, word in words.items()
    }
    commands = {
        name: {key: f"{name}_{kept}" for key, kept in ROBOT.commands.items()} for name in names
    }
    return Robot(
        model=model,
        poser=pose,
        begin=begin,
        act=act,
        table=table,
        commands=by_arm(commands),
        body="arms",
        proprio=tuple(f"{name}_{key}" for name in names for key in ROBOT.proprio),
        displaced=displaced,
        parts=by_arm(parts),
        # Each arm's jaw is the last of its actions.
        opens=tuple(-1 - i * len(ROBOT.actions["tip"]) for i in reversed(range(len(names)))),
        label=ROBOT.label,
        tool=ROBOT.tool,
        actions={
            control: tuple(f"{name}_{action}" for name in names for action in actions)
            for control, actions in ROBOT.actions.items()
        },
    )


def _of_one(row: Signal, name: str, word: str) -> Signal:
    """A signal of a single arm, read from the arm of this name."""
    sensors = tuple(one._replace(objname=f"{name}_{one.objname}") for one in row.sensors)
    return row._replace(meaning=f"{word}: {row.meaning}", sensors=sensors)
