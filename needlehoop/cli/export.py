"""``needlehoop export`` and ``pack``: the arm or the scene as MJCF, policies for others."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from needlehoop.cli.command import add_command, environment, new_file
from needlehoop.config import strict


def add_commands(commands: Any) -> None:
    """Add the commands to the subparsers of ``needlehoop``."""
    add_command(
        commands,
        "export",
        _export,
        "Write the arm, or the whole scene, as MJCF and meshes that MuJoCo opens by itself; or a"
        " trained policy as ONNX.",
        "what=arm|scene out=psm overwrite=false psm=parallelogram|serial; what=policy format=onnx"
        " run=<folder; the shipped agent's if none> out=policy.onnx",
    )
    summary = "Pack the trained agents of a study, one of each camera set, as files for a release."
    packed = commands.add_parser(
        "pack",
        help=summary,
        description=summary,
        epilog="A file of each: <cameras>.safetensors.xz, in bfloat16, 2 MiB at most. agents.csv"
        " says how often each succeeds, and SHA256SUMS is for sha256sum -c. After xz --decompress"
        " agents/*.xz, needlehoop.load_policy('dep_front+rgb_side') finds one.",
    )
    packed.add_argument("study", type=Path, metavar="STUDY", help="a study's folder, with policies")
    packed.add_argument(
        "--out", type=Path, metavar="FOLDER", default=Path("agents"), help="a new one (agents)"
    )
    packed.set_defaults(run=_pack, overrides=[])


def _pack(options: argparse.Namespace) -> None:
    if options.overrides:
        raise ValueError(f"{options.overrides[0]!r} is not understood; it takes a study")
    from needlehoop.api.released import pack

    files = pack(options.study, options.out)
    for path in files:
        print(f"{path}: {path.stat().st_size:,} bytes")


def _export(options: argparse.Namespace) -> None:
    settings, values = environment(options, "export")
    what = values["what"]
    overwrite = strict.value(values, "overwrite", bool)
    if what not in _FORMATS:
        raise ValueError(f"what: {what!r} is unknown; choose from {', '.join(_FORMATS)}")
    if values["format"] not in (None, _FORMATS[what]):
        raise ValueError(
            f"format: {values['format']!r} is unknown; what={what} is written as {_FORMATS[what]}"
        )
    if what == "policy":
        _export_policy(values["run"], Path(str(values["out"] or "policy.onnx")), overwrite)
        return
    if values["run"] is not None:
        raise ValueError(f"run: what={what} is of no run; it goes with what=policy")
    from needlehoop.scene import mjcf
    from needlehoop.scene.export import check_place, papers, write_folder

    out = Path(str(values["out"] or "psm"))
    check_place(out, overwrite)
    name, spec = _SPECS[what]
    written = mjcf.write(spec(settings), name)
    write_folder(out, {**written, **papers()}, overwrite)
    print(f"{out / name}.xml; look at it: python -m mujoco.viewer --mjcf={out / name}.xml")


def _export_policy(run: str | None, out: Path, overwrite: bool) -> None:
    from needlehoop.runs.files import write_whole
    from needlehoop.runs.shipped import AGENT

    new_file(out, ".onnx", overwrite)
    from needlehoop.api.trained import actor_in
    from needlehoop.learning.policy import PRECISION, onnx_bytes

    senses, actor, origin = actor_in(run or AGENT, "cpu", precision=PRECISION)
    content = onnx_bytes(senses, actor)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, content)
    print(f"{out}: {len(content) / 1e6:.1f} MB, {origin}; look at it: https://netron.app")


def _arm(settings: Any) -> Any:
    """The arm alone, with the keyframe ``home``."""
    import numpy as np

    from needlehoop.robot.parallelogram import Posture
    from needlehoop.robot.psm import HOME
    from needlehoop.tasks.layout import ArmLayout
    from needlehoop.tasks.psm import build_arm

    if not isinstance(settings.task, ArmLayout):
        raise ValueError(f"what: {settings.task.name} has no PSM; choose scene")
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

    spec = scene_spec(settings)
    task = settings.definition
    addresses = Addresses(spec.compile(), task.robot)
    middle = torch.full((1, task.draws), 0.5, dtype=torch.float64)
    nominal = task.start(settings.task, middle)
    spec.add_key(
        name="home",
        qpos=addresses.qpos(nominal)[0],
        ctrl=addresses.control(nominal)[0],
        mpos=addresses.mocap(nominal)[0].ravel(),
    )
    return spec


_FORMATS = {"arm": "mjcf", "scene": "mjcf", "policy": "onnx"}
"""What there is to export, and as what."""

_SPECS = {"arm": ("psm", _arm), "scene": ("scene", _scene)}
"""Of an MJCF: the file's name, and what makes the spec."""
