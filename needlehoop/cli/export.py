"""``needlehoop export``: the arm or the scene as plain MJCF."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from needlehoop.cli.command import add_command


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    add_command(
        commands,
        "export",
        _export,
        "Write the arm, or the whole scene, as MJCF and meshes that MuJoCo opens by itself.",
        "out=psm what=arm|scene overwrite=false psm=parallelogram|serial",
    )


def _export(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.scene import mjcf
    from needlehoop.scene.export import check_place, papers, write_folder

    values = config.compose(options.overrides, "export")
    settings, what, out = config.structure(values), values["what"], Path(str(values["out"]))
    overwrite = config.value(values, "overwrite", bool)
    if what not in _SPECS:
        raise ValueError(f"what: {what!r} is unknown; choose from {', '.join(_SPECS)}")
    check_place(out, overwrite)
    name, spec = _SPECS[what]
    written = mjcf.write(spec(settings), name)
    write_folder(out, {**written, **papers()}, overwrite)
    print(f"{out / name}.xml; look at it: python -m mujoco.viewer --mjcf={out / name}.xml")


def _arm(settings: Any) -> Any:
    """The arm alone, with the keyframe ``home``."""
    import numpy as np

    from needlehoop.robot.posture import Posture
    from needlehoop.robot.psm import HOME
    from needlehoop.scene.spec import build_arm

    spec = build_arm(settings.task, settings.psm)
    model = spec.compile()
    qpos = np.tile(model.qpos0, (1, 1))
    Posture(model).write(qpos, np.array([HOME]), np.zeros(1))
    spec.add_key(name="home", qpos=qpos[0], ctrl=[*HOME, 0.0])
    return spec


def _scene(settings: Any) -> Any:
    """The scene with every camera; ``home`` is the nominal start of an episode."""
    import torch

    from needlehoop.engines.addresses import Addresses
    from needlehoop.envs.build import scene_spec
    from needlehoop.task.start import DRAWS, start

    spec = scene_spec(settings)
    addresses = Addresses(spec.compile())
    nominal = start(settings.task, torch.full((1, DRAWS), 0.5, dtype=torch.float64))
    spec.add_key(
        name="home",
        qpos=addresses.qpos(nominal)[0],
        ctrl=addresses.control(nominal)[0],
        mpos=addresses.mocap(nominal)[0].ravel(),
    )
    return spec


_SPECS = {"arm": ("psm", _arm), "scene": ("scene", _scene)}
"""What there is to export: the file's name, and what makes the spec."""
