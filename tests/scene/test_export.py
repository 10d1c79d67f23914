"""``needlehoop export``: what was written is the scene, for those who have MuJoCo alone."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.cli.main import main
from needlehoop.cli.scenes import _arm
from needlehoop.envs.build import scene_spec
from needlehoop.envs.settings import compose_settings
from needlehoop.robot import psm
from needlehoop.scene import export

ROOT = Path(export.__file__).parents[2]
CAMS = "cams=[rgb_wrist]"
FILES = {"arm": "psm.xml", "scene": "scene.xml"}

ALONE = """
import sys
sys.modules["needlehoop"] = None
try:
    import needlehoop
except ImportError:
    pass
else:
    sys.exit("needlehoop can be imported here")
import mujoco, numpy as np
model = mujoco.MjModel.from_xml_path(sys.argv[1])
data = mujoco.MjData(model)
given = np.load(sys.argv[2])
assert model.nq == given["poses"].shape[1], (model.nq, given["poses"].shape)
poses, path = [], []
for qpos in given["poses"]:
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    poses.append(np.concatenate([getattr(data, n).ravel() for n in given["fields"]]))
mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
for ctrl in given["ctrl"]:
    data.ctrl = ctrl
    mujoco.mj_step(model, data)
    path.append(data.qpos.copy())
np.savez(sys.argv[3], poses=poses, path=path)
"""
FIELDS = ("xpos", "xmat", "site_xpos", "site_xmat", "geom_xpos", "geom_xmat")


def compiled(what: str, variant: str) -> mujoco.MjModel:
    settings = compose_settings([f"psm={variant}", CAMS])
    if what == "scene":
        return scene_spec(settings).compile()
    return _arm(settings).compile()


@pytest.fixture(
    scope="module",
    params=[
        ("arm", "parallelogram"),
        ("scene", "serial"),
        pytest.param(("arm", "serial"), marks=pytest.mark.full),
        pytest.param(("scene", "parallelogram"), marks=pytest.mark.full),
    ],
    ids="-".join,
)
def exported(request, tmp_path_factory) -> tuple[Path, mujoco.MjModel]:
    """An exported file, and the model that it has to be."""
    what, variant = request.param
    out = tmp_path_factory.mktemp(what) / variant
    assert main(["export", f"out={out}", f"what={what}", f"psm={variant}", CAMS]) == 0
    return out / FILES[what], compiled(what, variant)


def drawn(model: mujoco.MjModel, count: int) -> np.ndarray:
    """Random poses of every joint of a model, its linkage open, the needle anywhere."""
    generator = np.random.default_rng(0)
    poses = generator.uniform(-0.3, 0.3, (count, model.nq))
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            turn = slice(model.jnt_qposadr[joint] + 3, model.jnt_qposadr[joint] + 7)
            poses[:, turn] /= np.linalg.norm(poses[:, turn], axis=1, keepdims=True)
    return poses


def test_mujoco_alone_opens_it_and_it_moves_the_same(exported, tmp_path):
    path, model = exported
    again = mujoco.MjModel.from_xml_path(str(path))
    poses, data = drawn(model, 20), mujoco.MjData(model)
    waves = np.sin(np.outer(np.arange(100), 0.02 * np.arange(1, model.nu + 1)))
    home = again.key("home")
    controls = home.ctrl + 0.02 * waves
    np.savez(tmp_path / "given.npz", poses=poses, ctrl=controls, fields=FIELDS)
    command = [sys.executable, "-I", "-c", ALONE, path, tmp_path / "given.npz", tmp_path / "seen"]
    subprocess.run(command, check=True, cwd=tmp_path)
    seen = np.load(tmp_path / "seen.npz")
    for qpos, pose in zip(poses, seen["poses"], strict=True):
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        expected = np.concatenate([getattr(data, name).ravel() for name in FIELDS])
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-9)
    mujoco.mj_resetData(model, data)
    data.qpos, data.ctrl = home.qpos, home.ctrl
    data.mocap_pos[:] = home.mpos.reshape(-1, 3)
    begun = data.qpos.copy()
    for control, qpos in zip(controls, seen["path"], strict=True):
        data.ctrl = control
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(qpos, data.qpos, rtol=0, atol=1e-9)
    assert np.abs(data.qpos - begun).max() > 0.01


BY_THE_WAY = {
    "eq_data": "torquescale of a joint's equality, which has none",
    "site_size": "the second and third number of a ball",
}
"""What MuJoCo compiles otherwise, and does not use."""


def test_nothing_is_lost_but_the_last_bits(exported):
    path, model = exported
    again = mujoco.MjModel.from_xml_path(str(path))
    compared = 0
    # The keyframe and the files' names are new.
    new = ("_sizes", "key_", "name_", "names_map", "mesh_pathadr")
    for name in set(dir(model)) - {*BY_THE_WAY}:
        value, read_back = getattr(model, name), getattr(again, name)
        if isinstance(value, np.ndarray) and not name.startswith(new):
            scale = np.abs(value).max(initial=1e-9)
            np.testing.assert_allclose(read_back, value, rtol=0, atol=1e-9 * scale, err_msg=name)
            compared += 1
    assert compared > 200
    assert (model.ncam > 0) == ("scene" in path.name)
    width = {mujoco.mjtEq.mjEQ_CONNECT: 3, mujoco.mjtEq.mjEQ_JOINT: 5, mujoco.mjtEq.mjEQ_WELD: 11}
    for row, kind in enumerate(model.eq_type):
        used = slice(0, width[mujoco.mjtEq(kind)])
        np.testing.assert_allclose(again.eq_data[row, used], model.eq_data[row, used], atol=1e-12)


def test_the_arm_rests_at_home(tmp_path):
    for variant in psm.VARIANTS:
        out = tmp_path / variant
        assert main(["export", f"out={out}", f"psm={variant}"]) == 0
        model = mujoco.MjModel.from_xml_path(str(out / FILES["arm"]))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
        mujoco.mj_kinematics(model, data)
        place = data.site("tool").xpos.copy()
        np.testing.assert_allclose(place, [0, 0, -0.12 - 0.0091 + 0.0156], atol=1e-9)
        mujoco.mj_step(model, data, nstep=500)
        assert np.linalg.norm(data.site("tool").xpos - place) < 1e-5


def test_only_a_folder_of_its_own_files_is_written_over(tmp_path, capsys):
    out = tmp_path / "mine"
    assert main(["export", f"out={out}"]) == 0
    assert main(["export", f"out={out}"]) == 2
    assert "overwrite=true" in capsys.readouterr().err
    (out / "psm.xml").write_text("old")
    assert main(["export", f"out={out}", "overwrite=true"]) == 0
    assert (out / "psm.xml").read_text().startswith("<mujoco")
    (out / "notes.txt").write_text("precious")
    assert main(["export", f"out={out}", "overwrite=true"]) == 2
    assert "notes.txt" in capsys.readouterr().err
    assert (out / "notes.txt").read_text() == "precious"


def rows(readme: str, first: str) -> list[list[str]]:
    """Cells of the table of a Markdown text whose head begins with ``first``."""
    lines = readme.partition(f"| {first} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines]


def test_the_readmes_tables_are_the_models():
    readme = (ROOT / "needlehoop/robot/README.md").read_text()
    table = {cells[0]: cells[1:] for cells in rows(readme, "joint")}
    assert tuple(table) == (*psm.JOINT_NAMES, "jaw")
    models = [compiled("arm", variant) for variant in psm.VARIANTS]
    angles = {np.pi / 2: "π/2", -np.pi / 2: "-π/2", 0.0: "0"}
    turns = {np.pi / 2: "q + π/2", -np.pi / 2: "q - π/2", 0.0: "q"}
    for joint in psm.JOINTS:
        alpha, a, d, theta, *_ = table[joint.name]
        assert (alpha, float(a)) == (angles[joint.alpha], joint.a)
        if joint.prismatic:
            assert (d, theta) == (f"q - {-joint.d}", "0")
        else:
            assert (float(d), theta) == (joint.d, turns[joint.theta])
    for name, model in itertools.product(table, models):
        servo, joint = model.actuator(name), model.joint("jaw_1" if name == "jaw" else name)
        *limits, effort = (float(cell) for cell in table[name][-3:])
        assert limits == servo.ctrlrange.tolist()
        assert servo.forcerange.tolist() == [-effort, effort]
        assert model.jnt_limited[joint.id]
        assert name == "jaw" or limits == joint.range.tolist()
    golden = np.array([[float(cell) for cell in cells] for cells in rows(readme, "yaw | pitch")])
    assert golden.shape == (2, 9)
    positions = psm.forward_kinematics(torch.from_numpy(golden[:, :6]))[:, :3, 3]
    np.testing.assert_allclose(positions, golden[:, 6:], atol=1e-6)


def test_the_licence_is_the_projects():
    assert export.papers()["LICENSE"] == (ROOT / "LICENSE").read_text()
