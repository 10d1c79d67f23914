"""The scene in 3D: the bodies of a model, the cameras' frustums, and a handle to move one with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
from viser import SceneApi, TransformControlsEvent, TransformControlsHandle

from needlehoop.disturbances.optics import STRANGE
from needlehoop.engines.rasteriser.solids import surface_of
from needlehoop.scene.cameras import View, pose_of

_TABLE = (0.5, 0.5, 0.004)
"""Of the part of the table that is drawn, m."""

_FRUSTUM, _HANDLE = 0.04, 0.07
"""Sizes of frustums and of the handle, m."""

_TURN = (0.0, 1.0, 0.0, 0.0)
"""From MuJoCo's cameras, which look along -z with y up, to viser's, along z with y down."""

_INK, _CHOSEN = (60, 66, 76), (220, 80, 20)


class Stage:
    """Draws in viser's scene; all nodes are the same in every tab.

    ``chosen`` is called with a view's name when its frustum is clicked; ``moved`` with position
    ``(3,)`` and quaternion ``(4,)``, in the frame of the chosen view's body, while its handle is
    dragged.
    """

    def __init__(
        self,
        scene: SceneApi,
        chosen: Callable[[str], None],
        moved: Callable[[np.ndarray, np.ndarray], None],
    ):
        self._scene, self._chosen, self._moved = scene, chosen, moved
        self._model: mujoco.MjModel | None = None
        self._bodies: list[Any] = []
        self._poses = np.zeros((0, 7))
        self._views: dict[str, tuple[View, bool]] = {}
        self._handle: TransformControlsHandle | None = None
        self._is_dragged = False
        scene.set_up_direction("+z")

    def show(self, model: mujoco.MjModel, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Put the bodies where they are: ``(nbody, 3)`` m and ``(nbody, 4)``, world frame."""
        if model is not self._model:
            if self._model is None or _looks(model) != _looks(self._model):
                self._draw(model)
            self._model = model
        poses = np.hstack((position, quaternion))
        for body in np.flatnonzero((poses != self._poses).any(1)):
            self._bodies[body].position = position[body]
            self._bodies[body].wxyz = quaternion[body]
        self._poses = poses

    def _draw(self, model: mujoco.MjModel) -> None:
        """Draw all bodies anew, each at its origin; cameras have to be drawn again."""
        for body in self._bodies:
            body.remove()
        self._views, self._handle = {}, None
        names = [_path(model.body(body).name) for body in range(model.nbody)]
        self._bodies = [self._scene.add_frame(name, show_axes=False) for name in names]
        self._poses = np.tile([0.0, 0, 0, 1, 0, 0, 0], (model.nbody, 1))
        for geom in np.flatnonzero(np.isin(model.geom_group, (0, 1))):
            if model.geom(geom).name.startswith(STRANGE):
                # Out of sight: only what cameras see is disturbed.
                continue
            name = f"{names[model.geom_bodyid[geom]]}/geom_{geom}"
            material = model.geom_matid[geom]
            rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
            look: dict[str, Any] = {"color": tuple((255 * rgba[:3]).astype(int).tolist())}
            look["wxyz"] = model.geom_quat[geom]
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
                middle = (0.0, 0.0, -_TABLE[2] / 2)
                self._scene.add_box(name, dimensions=_TABLE, position=middle, **look)
                continue
            look |= {"position": model.geom_pos[geom], "flat_shading": True}
            surface = surface_of(model, int(geom))
            self._scene.add_mesh_simple(name, surface.vertices, surface.faces, **look)

    def place(self, views: Mapping[str, View], chosen: str) -> None:
        """Draw the cameras; the chosen one has the handle."""
        for name, view in views.items():
            look = (view, name == chosen)
            if self._views.get(name) != look:
                self._place(name, *look)
                self._views[name] = look

    def _place(self, name: str, view: View, is_chosen: bool) -> None:
        position, quaternion = pose_of(view)
        above = f"{_path(view.body or 'world')}/view_{name}"
        pose: dict[str, Any] = {"position": position, "wxyz": quaternion}
        self._scene.add_frame(above, show_axes=False, **pose)
        shape = self._scene.add_camera_frustum(
            f"{above}/frustum",
            fov=float(np.deg2rad(view.fovy)),
            aspect=1.0,
            scale=_FRUSTUM,
            thickness=0.001,
            color=_CHOSEN if is_chosen else _INK,
            wxyz=_TURN,
        )
        shape.on_click(lambda _: self._chosen(name))
        self._scene.add_label(f"{above}/name", name)
        if not is_chosen:
            return
        if self._handle is not None and self._handle.name == f"{above}_handle":
            # While it is dragged, the hand is ahead of the view.
            if not self._is_dragged:
                self._handle.position, self._handle.wxyz = position, quaternion
            return
        if self._handle is not None:
            self._handle.remove()
        self._handle = self._scene.add_transform_controls(
            f"{above}_handle", scale=_HANDLE, depth_test=False, **pose
        )
        self._handle.on_update(self._drag)

    async def _drag(self, event: TransformControlsEvent) -> None:
        # Not in a pool of threads, which would mix up the order of the moves.
        self._is_dragged = event.phase != "end"
        self._moved(np.array(event.target.position), np.array(event.target.wxyz))


def _path(body: str) -> str:
    return f"/bodies/{body}"


def _looks(model: mujoco.MjModel) -> tuple[Any, ...]:
    """What a drawing of a model depends on; cameras are drawn apart."""
    fields = ("geom_pos", "geom_quat", "geom_size", "geom_rgba", "mesh_vert")
    return (model.nbody, *(getattr(model, name).tobytes() for name in fields))
