"""A folder with a scene in it, for those who have MuJoCo and none of our Python."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from needlehoop.config import strict
from needlehoop.runs.files import check_free
from needlehoop.runs.reading import read_json

RECORD = "export.json"
"""What of a folder's files was written by an export."""

_MESHES = "assets"
"""Folder of the meshes, beside the MJCF."""

_ROUNDED = {
    "worldbody//body": ("body_pos", "body_quat"),
    "worldbody//joint": ("jnt_pos", "jnt_range"),
    "worldbody//geom": ("geom_pos", "geom_quat", "geom_size"),
    "worldbody//site": ("site_pos", "site_quat", "site_size"),
    "worldbody//camera": ("cam_pos", "cam_quat", "cam_fovy"),
    "worldbody//light": ("light_pos", "light_dir"),
    "actuator/general": (
        *("actuator_ctrlrange", "actuator_forcerange"),
        *("actuator_gainprm", "actuator_biasprm"),
    ),
    "keyframe/key": ("key_qpos", "key_ctrl", "key_mpos", "key_mquat"),
}
"""Elements, and the model's fields that their attributes (the word after ``_``) are rounded of."""


def papers() -> dict[str, str]:
    """What goes with every model: the licence, and where the arm's numbers are from."""
    robot = Path(__file__).parents[1] / "robot"
    return {name: (robot / name).read_text("utf-8") for name in ("LICENSE", "README.md")}


def check_place(out: Path, overwrite: bool) -> None:
    """Raises ``ValueError`` where an export may not be written."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"out: {str(out)!r} is a file; name a folder")
    check_free(out, overwrite)


def write_folder(out: Path, files: Mapping[str, str]) -> None:
    """Write files below a folder, all of them or none.

    Args:
        out: the folder, of which ``check_place`` says whether it may exist; it is made. In one
            that exists only what an export has written is replaced, and nothing is deleted.
        files: texts by path below ``out``.

    Raises:
        ValueError: a file in ``out`` that no export has written is in the way.
    """
    own = _written_before(out)
    foreign = sorted(name for name in files if (out / name).exists() and name not in own)
    if foreign:
        raise ValueError(
            f"out: {str(out / foreign[0])!r} was not written by an export; choose another folder"
        )
    record = json.dumps({"files": sorted({*own, *files})}, indent=2) + "\n"
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as beside:
        fresh = Path(beside) / "fresh"
        # The record first: what is cut off half-way can be written over again.
        for name, text in {RECORD: record, **files}.items():
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            (fresh / name).write_text(text, "utf-8")
        if not out.exists():
            fresh.rename(out)
            return
        for name in (RECORD, *files):
            (out / name).parent.mkdir(exist_ok=True)
            (fresh / name).replace(out / name)


def _written_before(out: Path) -> set[str]:
    try:
        found = read_json(out / RECORD)["files"] if (out / RECORD).exists() else []
        return set(strict.structure(found, tuple[str, ...], "files"))
    except (ValueError, KeyError) as error:
        raise ValueError(f"out: {str(out / RECORD)!r} is no record of an export") from error


def mjcf(spec: mujoco.MjSpec, name: str) -> dict[str, str]:
    """Files of a scene by their path: ``<name>.xml`` and its meshes; they lose nothing.

    MuJoCo writes numbers with six digits, which is a micrometre at the tool's tip. What it rounded
    is put back from the compiled model, and what comes of it is opened again and compared. The
    spec is compiled, otherwise left as it is.

    Raises:
        RuntimeError: MuJoCo does not make the same scene of what was written.
    """
    model = spec.compile()
    root = ElementTree.fromstring(spec.to_xml())
    _put_back(root, spec, model)
    for servo in root.findall("actuator/general"):
        _name_servo(servo)
    meshes = {}
    for element in root.iter("mesh"):
        meshes[f"{_MESHES}/{element.get('name')}.obj"] = _move_out(element, spec, model)
    compiler = root.find("compiler")
    assert compiler is not None
    compiler.set("meshdir", _MESHES)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode") + "\n"
    _compare(model, text, meshes)
    return {f"{name}.xml": text, **meshes}


def _put_back(root: Element, spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """The digits that were rounded away; elements stand in the order of the model's ids."""
    for path, fields in _ROUNDED.items():
        # The world is a body, and has no element of its own.
        for index, element in enumerate(root.iterfind(path), start=path == "worldbody//body"):
            if element.get("type") != "mesh":
                for field in fields:
                    _sharpen(element, field.partition("_")[2], getattr(model, field)[index])
    masses = {geom.id: geom.mass for geom in spec.geoms}
    for index, element in enumerate(root.iterfind("worldbody//geom")):
        _sharpen(element, "mass", masses[index])
    for index, element in enumerate(root.iterfind("equality/*")):
        if element.tag == "connect":
            _sharpen(element, "anchor", model.eq_data[index])
    for element in root.iterfind("worldbody//joint"):
        dof = int(model.joint(element.get("name")).dofadr[0])
        for name in ("armature", "damping", "frictionloss"):
            _sharpen(element, name, getattr(model, f"dof_{name}")[dof])


def _sharpen(element: Element, attribute: str, exact: np.ndarray) -> None:
    """Write an attribute again, in full; one that is left out is a default and stays out."""
    rounded = element.get(attribute)
    if rounded is None:
        return
    numbers = np.array(rounded.split(), float)
    full = np.ravel(exact)[: len(numbers)]
    if not np.allclose(full, numbers, rtol=1e-5, atol=1e-9):
        where = f"{element.tag} {element.get('name', '')} {attribute}"
        raise RuntimeError(f"export: {where}: {rounded} is not what was compiled, {full}")
    # What is nothing but rounding is 0. A 16th digit would spell 0.05 as 0.050000000000000003.
    element.set(attribute, " ".join(f"{0.0 if abs(x) < 1e-15 else x:.15g}" for x in full))


def _name_servo(actuator: Element) -> None:
    """Spell a position servo as one, which older versions of MuJoCo read too."""
    gain, bias = (actuator.attrib.pop(f"{name}prm").split() for name in ("gain", "bias"))
    for name in ("biastype", "input"):
        actuator.attrib.pop(name, None)
    actuator.tag = "position"
    actuator.set("kp", gain[0])
    actuator.set("kv", bias[2].removeprefix("-"))


def _move_out(element: Element, spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    """A mesh as Wavefront OBJ; its element names the file from now on."""
    name = element.get("name", "")
    # Faces of the model: a blade is given by its corners, and MuJoCo spans the hull.
    start, count = model.mesh(name).faceadr[0], model.mesh(name).facenum[0]
    faces = model.mesh_face[start : start + count] + 1
    vertices = np.array(spec.mesh(name).uservert, np.float32).reshape(-1, 3)
    for attribute in ("vertex", "face"):
        element.attrib.pop(attribute, None)
    element.set("file", f"{name}.obj")
    lines = [f"o {name}"]
    lines += ["v " + " ".join(map(str, vertex)) for vertex in vertices]
    lines += ["f " + " ".join(map(str, face)) for face in faces]
    return "\n".join(lines) + "\n"


def _compare(model: mujoco.MjModel, text: str, meshes: dict[str, str]) -> None:
    """Open what is to be written: its first pose is the scene's, to 1e-9 m."""
    assets = {path: mesh.encode() for path, mesh in meshes.items()}
    again = mujoco.MjModel.from_xml_string(text, assets)
    if (again.nq, again.nu, again.nbody) != (model.nq, model.nu, model.nbody):
        raise RuntimeError("export: what was written has other bodies, joints or servos")
    here, there = mujoco.MjData(model), mujoco.MjData(again)
    for each, data in ((model, here), (again, there)):
        if each.nkey:
            mujoco.mj_resetDataKeyframe(each, data, 0)
        mujoco.mj_kinematics(each, data)
        mujoco.mj_comPos(each, data)
        mujoco.mj_camlight(each, data)
    for name in ("xpos", "xmat", "site_xpos", "site_xmat", "cam_xpos", "cam_xmat"):
        apart = np.abs(getattr(here, name) - getattr(there, name)).max(initial=0.0)
        if not apart < 1e-9:
            raise RuntimeError(f"export: {name} of what was written is {apart:.1e} apart")
