"""Signals: what the scene's named sensors and the task say at one moment; see ``vocabulary``."""

from __future__ import annotations

import mujoco
import torch
from tensordict import TensorClass
from torch import Tensor

from needlehoop.robot.joints import JOINT_NAMES
from needlehoop.scene.spec import SENSORS
from needlehoop.scene.vocabulary import TABLE


class Signals(TensorClass):
    """Signals of ``n`` environments; shapes, units and frames are in ``TABLE``.

    Floating signals are float64, so that every engine gives the same bits.
    """

    tool_midpoint: Tensor
    tool_quat: Tensor
    wrist_pos: Tensor
    wrist_quat: Tensor
    pickup_point: Tensor
    needle_tip: Tensor
    needle_quat: Tensor
    goal: Tensor
    hoop_axis: Tensor
    lift_position: Tensor
    joints: Tensor
    jaw: Tensor
    jaw_1_touch: Tensor
    jaw_2_touch: Tensor
    jaw_command: Tensor
    elapsed: Tensor
    grasped: Tensor
    lifted: Tensor
    touched: Tensor
    threaded: Tensor


class Readings:
    """Cuts ``sensordata`` into named readings.

    Args:
        model: a compiled scene.
    """

    def __init__(self, model: mujoco.MjModel):
        self._slices = {}
        for name in SENSORS:
            sensor = model.sensor(name)
            start, size = int(sensor.adr[0]), int(sensor.dim[0])
            self._slices[name] = slice(start, start + size)

    def __call__(self, sensordata: Tensor) -> dict[str, Tensor]:
        """Readings by signal name from ``sensordata`` ``(n, nsensordata)``: views of it."""
        read = {}
        for name in TABLE:
            if name in self._slices:
                value = sensordata[:, self._slices[name]]
                read[name] = value if TABLE[name].shape else value[:, 0]
        read["joints"] = torch.cat([sensordata[:, self._slices[name]] for name in JOINT_NAMES], -1)
        for name in ("jaw_1_touch", "jaw_2_touch"):
            read[name] = read[name] > 0
        return read


PROPRIO_SIZE = 8
"""Numbers in ``proprio``."""


def proprio(signals: Signals) -> Tensor:
    """What the robot knows of itself: six joints, jaw, jaw command; ``(n, 8)`` float32."""
    columns = (signals.joints, signals.jaw.unsqueeze(-1), signals.jaw_command.unsqueeze(-1))
    return torch.cat(columns, -1).float()
