from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from needle_task import begun_data, readings_of, start

from needlehoop.scene.signals import describe, sensors_of, vocabulary
from needlehoop.tasks.needle_hoop import TASK, facts
from needlehoop.tasks.needle_hoop.scene import NeedleLayout
from needlehoop.tasks.start import draws

TABLE = TASK.signals

VERDICTS = ("touched", "threaded")


@pytest.fixture
def data(model: mujoco.MjModel, layout: NeedleLayout) -> mujoco.MjData:
    """A scene in the middle of some movement, the needle in the air and turned."""
    begun = start(layout, torch.from_numpy(draws(1, 2, 3))[None])
    data = begun_data(model, begun)
    data.ctrl[:] += [0.1, -0.1, 0.01, 0.3, 0.4, -0.5, -0.2]
    place = model.joint("needle").qposadr[0]
    data.qpos[place + 2] = 0.08
    data.qpos[place + 3 : place + 7] = np.array([0.5, -0.5, 0.7, 0.1])
    data.qvel[model.joint("needle").dofadr[0] + 3] = 5.0
    mujoco.mj_step(model, data, nstep=20)
    mujoco.mj_forward(model, data)
    return data


def read(model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, np.ndarray]:
    readings = readings_of(model)(torch.from_numpy(data.sensordata.copy())[None])
    return {name: value[0].numpy() for name, value in readings.items()}


def test_every_sensor_exists_and_reads_what_it_says(model: mujoco.MjModel):
    assert [model.sensor(i).name for i in range(model.nsensor)] == list(sensors_of(TABLE))
    for name, spec in sensors_of(TABLE).items():
        sensor = model.sensor(name)
        assert sensor.type[0] == spec.type
        read = mujoco.mj_id2name(model, sensor.objtype[0], sensor.objid[0])
        assert (sensor.objtype[0], read) == (spec.objtype, spec.objname)
        if spec.body:
            other = mujoco.mj_id2name(model, sensor.reftype[0], sensor.refid[0])
            assert (sensor.reftype[0], other) == (mujoco.mjtObj.mjOBJ_BODY, spec.body)


def test_the_hoops_axis_goes_through_the_opening(model: mujoco.MjModel, data: mujoco.MjData):
    values = read(model, data)
    np.testing.assert_allclose(values["hoop_axis"], [0.0, 1.0, 0.0], atol=1e-12)
    ring = np.array([data.geom(f"hoop_{i}").xpos for i in range(16)])
    np.testing.assert_allclose((ring - values["goal"]) @ values["hoop_axis"], 0.0, atol=1e-12)


def test_the_tip_and_the_tool_are_where_the_layout_puts_them(
    model: mujoco.MjModel, data: mujoco.MjData, layout: NeedleLayout
):
    values = read(model, data)
    curve = facts.centre_line(
        layout,
        torch.from_numpy(values["pickup_point"])[None],
        torch.from_numpy(values["needle_quat"])[None],
    )
    np.testing.assert_allclose(curve[0, -1], values["needle_tip"], atol=1e-9)
    reach = np.linalg.norm(values["tool_midpoint"] - values["wrist_pos"])
    assert reach == pytest.approx(layout.grip)


def test_the_description_lists_all_but_the_verdicts():
    head, *lines = describe(vocabulary(TABLE)).splitlines()
    assert head.split() == ["name", "shape", "unit", "frame", "source", "meaning"]
    assert [line.split()[0] for line in lines] == [n for n in TABLE if n not in VERDICTS]
