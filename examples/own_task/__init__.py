"""A task of one's own: a gantry puts a cube on a spot. ``docs/own-task.md`` walks through it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import torch
from torch import Tensor

from needlehoop.config.strict import Positive
from needlehoop.robot.geometry import aside, distance
from needlehoop.scene.shapes import collision
from needlehoop.scene.signals import of_body
from needlehoop.tasks.contract import Fact, FlatClass, Memory, Phase, Task, Telling, Weld
from needlehoop.tasks.layout import Episode, Length, Place, Spread, ToolLayout, lengths, millimetres
from needlehoop.tasks.start import Chance, Start, standing

from .expert import expert
from .robot import ROBOT, servos


@dataclass(frozen=True)
class CubeLayout(ToolLayout):
    """Sizes and placement, m; ranges are half-widths about the nominal value."""

    cube: Length
    """Edge."""
    spot: Length
    """Radius that is drawn."""
    cube_position: tuple[Place, Place]
    spot_position: tuple[Place, Place]
    position_range: tuple[Spread, Spread]
    """Of cube and spot."""
    open: Length
    """Most that a finger's joint opens."""


@dataclass(frozen=True)
class CubeRules(Episode):
    """Scales of actions and thresholds, m."""

    CONTROLS: ClassVar[dict[str, int]] = {"axes": 4}

    translation: Positive
    grip: Positive
    spot_radius: Positive
    """``placed``: the cube's middle is this near the spot's, seen from above."""


def build(spec: mujoco.MjSpec, layout: CubeLayout, rules: CubeRules) -> None:
    """Add the cube and the spot."""
    cube = spec.worldbody.add_body(name="cube", pos=[0, 0, layout.cube / 2])
    cube.add_freejoint(name="cube")
    shape = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [layout.cube / 2] * 3}
    cube.add_geom(name="cube", material="cube", mass=0.004, solref=[0.004, 1.0], group=1, **shape)
    spot = spec.worldbody.add_body(name="spot", mocap=True)
    disc = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": [layout.spot, 0.0004, 0]}
    spot.add_geom(name="spot", material="spot", **disc, **collision(False))


def start(layout: CubeLayout, chance: Chance) -> Start:
    """Scatter cube, spot and hand."""
    cube = chance.place(layout.cube_position, layout.position_range)
    spot = chance.place(layout.spot_position, layout.position_range)
    tool = chance.place(layout.tool_position, layout.tool_position_range)
    zero = torch.zeros_like(tool[:, 0])
    opening = zero + layout.open
    return Start(
        robot={"tool": tool, "opening": opening},
        free={"cube": standing(cube, layout.cube / 2, yaw=zero)},
        mocap={"spot": torch.cat((spot, zero.unsqueeze(-1)), -1)},
        control=servos(tool, opening),
    )


def observe(
    layout: CubeLayout, rules: CubeRules, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Weld]]:
    """Held: both fingers touch the cube. Placed: it lies on the spot and no finger touches it."""
    r = readings
    there = aside(r["cube"] - r["spot"]) < rules.spot_radius
    lies = r["cube"][:, 2] < layout.cube / 2 + 0.0005
    one, two = r["finger_1_touch"], r["finger_2_touch"]
    return {"held": one & two, "placed": there & lies & ~one & ~two}, {}


@dataclass(frozen=True)
class Human:
    """What a person would pay: come to the cube, bring it to the spot, leave it there."""

    scale: Positive  # Distance over which closeness falls to a third, m.

    def __call__(self, signals: Any) -> dict[str, Tensor]:
        """Terms ``(n,)`` by name; being done pays more than anything else."""
        s = signals
        come = torch.exp(-distance(s.tool, s.cube) / self.scale)
        return {
            "come": torch.where(s.held | s.placed, 1.0, come),
            "bring": 3.0 * torch.exp(-distance(s.cube, s.spot) / self.scale),
            "place": 4.0 * s.placed.double(),
            "time": -s.elapsed,
        }


def values(layout: CubeLayout, rules: CubeRules) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    return {
        **lengths(layout),
        "half": millimetres(layout.cube / 2),
        "height": millimetres(layout.tool_position[2]),
        "open": f"{layout.open:g}",
        "control": f"moves the gripper by up to {millimetres(rules.translation)} mm along each of"
        f" x, y and z, and opens or closes each finger by up to {millimetres(rules.grip)} mm",
    }


TASK = Task(
    name="cube_on_spot",
    summary="A gantry picks a cube up and puts it on a spot.",
    robot=ROBOT,
    layout=CubeLayout,
    rules=CubeRules,
    materials={"cube": ((0.9, 0.3, 0.2), 0.2, 0.3), "spot": ((0.95, 0.9, 0.4), 0.1, 0.2)},
    build=build,
    things={
        "cube": of_body("position", "cube", "middle of the cube"),
        "spot": of_body("position", "spot", "middle of the spot, on the table"),
    },
    holds="cube",
    classes={
        "cube": FlatClass(("cube",), (255, 0, 80)),
        "spot": FlatClass(("spot",), (255, 230, 0)),
    },
    start=start,
    facts=(
        Fact("held", "both fingers touch the cube", once=True),
        Fact("placed", "the cube lies on the spot, let go", verdict=True),
    ),
    observe=observe,
    goal="placed",
    phases=(Phase("pick", "held", ("tool", "cube")), Phase("put", "placed", ("cube", "spot"))),
    state=("tool", "cube", "spot", "grip", "grip_command", "held"),
    controllers={"expert": expert},
    teacher="expert",
    human=Human,
    critic=("held",),
    telling=Telling(
        texts=Path(__file__).parent / "prompts",
        values=values,
        goal="the cube lies on the spot, let go",
        done="the cube is where it has to be",
        front="the table",
        moments={"held": "both fingers hold the cube"},
    ),
)
