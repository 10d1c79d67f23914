"""Views that were moved: from a pose to a view, and into a file of the user's own."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from needlehoop.runs.files import check_folder, check_free, write_whole
from needlehoop.runs.shipped import CONF
from needlehoop.scene.cameras import View, pose_of

_DIGITS = 5
"""Of lengths in m and of directions: a hundredth of a millimetre."""


def posed(view: View, position: np.ndarray, quaternion: np.ndarray) -> View:
    """A view somewhere else, with its angle, depths and body.

    ``position`` ``(3,)`` m and ``quaternion`` ``(4,)``, as ``pose_of`` gives them.
    """
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    _, up, back = matrix.reshape(3, 3).T
    return _standing(view, position, -back, up)


def aimed(view: View, point: np.ndarray) -> View:
    """The same place, looking at a point ``(3,)``, m, in the frame of the view's body.

    In the room z is up in its image. On a body, or where it looks along z, up stays as it was.
    ``ValueError``: the view stands in the point.
    """
    position, quaternion = pose_of(view)
    forward = point - position
    if not forward.any():
        raise ValueError("view: it stands in the point that it is to look at; move it first")
    up = np.array((0.0, 0.0, 1.0))
    if view.body is not None or np.abs(forward[:2]).max() < 1e-6:
        up = np.asarray(posed(view, position, quaternion).up)
    return _standing(view, position, forward / np.linalg.norm(forward), up)


def _standing(view: View, position: np.ndarray, forward: np.ndarray, up: np.ndarray) -> View:
    pose: dict[str, Any] = dict.fromkeys(("target", "azimuth", "elevation", "distance"))
    for key, value in (("position", position), ("forward", forward), ("up", up)):
        # No -0.0 in a file.
        pose[key] = tuple((value.round(_DIGITS) + 0.0).tolist())
    return replace(view, roll=0.0, **pose)


def save(view: View, name: str, folder: str, overwrite: bool) -> Path:
    """Write ``view/<name>.yaml`` into a config folder, which is made where it is missing.

    ``ValueError``: a name that no camera can have, or that is taken; or a folder that is none.
    """
    if not re.fullmatch(r"[A-Za-z]\w{0,39}", name):
        raise ValueError(f"name: {name!r} must be a letter, then letters, digits and _")
    taken = sorted(file.stem for file in (CONF / "view").rglob("*.yaml"))
    if name in taken:
        raise ValueError(f"name: {name!r} is taken, as are {', '.join(taken)}; choose another")
    check_folder("folder", folder)
    path = Path(folder) / "view" / f"{name}.yaml"
    check_free(path, overwrite, "name")
    entries = {k: list(v) if isinstance(v, tuple) else v for k, v in view.given.items()}
    # Lists in one line each.
    text = yaml.safe_dump(entries, default_flow_style=None, sort_keys=False)
    head = "# Placed with needlehoop studio.\n# Lengths in m, angles in degrees: docs/cameras.md.\n"
    write_whole(path, head + text)
    return path
