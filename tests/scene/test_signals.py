from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from needle_task import begun_data, readings_of, start

from needlehoop.scene.signals import describe, sensors_of, vocabulary
from needlehoop.tasks.needle_hoop import TASK, facts
from needlehoop.tasks.needle_hoop.scene import NeedleLayout
from needlehoop.tasks.start import NUMBERS, draws

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


def test_every_element_of_the_scene_has_a_name(model: mujoco.MjModel):
    counts = {"body": "nbody", "joint": "njnt", "site": "nsite", "actuator": "nu", "camera": "ncam"}
    counts |= {"sensor": "nsensor", "light": "nlight", "equality": "neq", "tendon": "ntendon"}
    for kind, count in counts.items():
        names = [getattr(model, kind)(i).name for i in range(getattr(model, count))]
        assert names
        assert all(names)
        assert len(set(names)) == len(names)


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


@pytest.mark.parametrize(
    ("across", "expected"),
    [
        pytest.param(0.0, (True, True), id="between closed jaws"),
        pytest.param(0.0028, (True, False), id="outside one"),
        pytest.param(-0.0028, (False, True), id="outside the other"),
        pytest.param(0.02, (False, False), id="away"),
    ],
)
def test_touch_is_contact_of_that_jaw_with_the_needle(
    model: mujoco.MjModel, layout: NeedleLayout, across, expected
):
    begun = start(layout, torch.full((1, NUMBERS), 0.5, dtype=torch.float64))
    begun.robot["jaw"][:] = 0.0
    data = begun_data(model, begun)
    mujoco.mj_kinematics(model, data)
    tool = data.site("tool").xmat.reshape(3, 3)
    # The needle runs along the tool's x: across the blades, which open along y.
    turn = np.stack((-tool[:, 1], tool[:, 0], tool[:, 2]), -1)
    place = model.joint("needle").qposadr[0]
    data.qpos[place : place + 3] = data.site("tool_midpoint").xpos + across * tool[:, 1]
    mujoco.mju_mat2Quat(data.qpos[place + 3 : place + 7], turn.ravel())
    mujoco.mj_forward(model, data)
    values = read(model, data)
    assert (bool(values["jaw_1_touch"]), bool(values["jaw_2_touch"])) == expected
    needle = model.body("needle").id
    for index, touches in enumerate(expected, start=1):
        pad = model.geom(f"jaw_{index}_pad").id
        pairs = [set(pair) for pair in data.contact.geom if pad in pair]
        bodies = {int(model.geom_bodyid[geom]) for pair in pairs for geom in pair - {pad}}
        assert (needle in bodies) == touches


def test_the_description_lists_all_but_the_verdicts():
    head, *lines = describe(vocabulary(TABLE)).splitlines()
    assert head.split() == ["name", "shape", "unit", "frame", "source", "meaning"]
    assert [line.split()[0] for line in lines] == [n for n in TABLE if n not in VERDICTS]
