"""A folder with a scene in it, for those who have MuJoCo and none of our Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from needlehoop.runs.files import new_folder, write_whole

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
"""Elements, and the model's fields that hold their attributes (the word after ``_``) in full."""


def papers() -> dict[str, str]:
    """What goes with every model: the licence, and where the arm's numbers are from."""
    robot = Path(__file__).parents[1] / "robot"
    return {name: (robot / name).read_text("utf-8") for name in ("LICENSE", "README.md")}


def write_folder(out: Path, files: Mapping[str, str], overwrite: bool) -> None:
    """Write texts by their path below a folder, all of them or none.

    Raises:
        ValueError: the folder exists, and ``overwrite`` is false or it has other files as well.
    """
    there = [file for file in sorted(out.rglob("*")) if file.is_file()]
    foreign = [file for file in there if str(file.relative_to(out)) not in files]
    if overwrite and foreign:
        raise ValueError(
            f"out: {str(foreign[0])!r} is not of this export, and would be lost; choose another"
            " folder"
        )
    with new_folder(out, overwrite) as folder:
        for name, text in files.items():
            write_whole(folder / name, text)


def mjcf(spec: mujoco.MjSpec, name: str) -> dict[str, str]:
    """Files of a scene by their path: ``<name>.xml`` and its meshes; they lose nothing.

    MuJoCo writes numbers with six digits, which is a micrometre at the tool's tip. What it rounded
    is put back from the compiled model. The spec is compiled, otherwise left as it is.

    Raises:
        RuntimeError: a number in the text is not the compiled one, rounded.
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
    return {f"{name}.xml": ElementTree.tostring(root, encoding="unicode") + "\n", **meshes}


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
