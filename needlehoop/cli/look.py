"""Commands that show the scene or a controller, or write them down for other programs."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from needlehoop.cli.command import JSON, KEYS, argument, command, environment, new_file
from needlehoop.config import strict
from needlehoop.config.strict import Amount, Count, OneOf, Pixels

Levels = dict[str, dict[str, tuple[Amount, ...]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


@command(KEYS, config="snapshot")
def snapshot(options: argparse.Namespace) -> None:
    """Write a contact sheet of all views and renderings, start and goal."""
    flags = dict.fromkeys(("overwrite", "tiles", "raw", "disturbed"), bool)
    settings, asked = environment(options, "snapshot", out=str, size=Pixels, levels=Levels, **flags)
    if asked.tiles and Path(asked.out).suffix:
        raise ValueError(f"out: {asked.out!r}; tiles=true writes a folder")
    out = new_file(asked.out, "" if asked.tiles else ".png", asked.overwrite)
    from needlehoop.pictures import stills

    if asked.tiles:
        for name, image in stills.tiles(settings).items():
            _save(image, out / f"{name}.png")
    elif asked.disturbed:
        _save(stills.disturbed_sheet(settings, asked.levels, asked.size), out)
    else:
        _save(stills.contact_sheet(settings, asked.size, asked.raw), out)


@command(KEYS, config="picture")
def picture(options: argparse.Namespace) -> None:
    """Write one large picture of the start, from any place."""
    settings, asked = environment(options, "picture", out=str, overwrite=bool, size=Pixels)
    out = new_file(asked.out, ".png", asked.overwrite)
    from needlehoop.pictures.stills import portrait

    _save(portrait(settings, asked.size), out)


def _save(image: Any, out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    image.save(out)
    print(f"{out}: {image.width} x {image.height} px")


@command(
    KEYS,
    JSON,
    argument("--video", type=Path, metavar="OUT.mp4", help="also write a video"),
    config="expert",
)
def expert(options: argparse.Namespace) -> None:
    """Run a scripted controller and print what came of it."""
    kinds = {"controller": str, "grasps": strict.Names | None, "overwrite": bool}
    settings, asked = environment(options, "expert", episodes=Count, video_episodes=Count, **kinds)
    who, grasps = asked.controller, _grasps(asked.grasps, options)
    if options.video is not None:
        new_file(options.video, ".mp4", asked.overwrite, "--video")
    from needlehoop.envs.controllers import run_trials
    from needlehoop.tasks.layout import ArmEpisode

    tried = {"episodes": settings}
    if isinstance(settings.episode, ArmEpisode):
        rules = settings.episode
        grasps = grasps or (rules.grasp,)
        tried = {one: replace(settings, episode=replace(rules, grasp=one)) for one in grasps}
    found = {one: run_trials(own, who, asked.episodes).summary() for one, own in tried.items()}
    if options.json:
        print(json.dumps({"controller": who, "seed": settings.seed, **found}))
    else:
        print(f"{who}, {asked.episodes} episodes each, seed {settings.seed}")
        print(" " * 12 + "".join(f"{column:>12}" for column in found))
        for name, first in next(iter(found.values())).items():
            form = "12d" if isinstance(first, int) else "12.3f"
            print(f"{name:12}{''.join(f'{column[name]:{form}}' for column in found.values())}")
    if options.video is None:
        return
    from needlehoop.envs.build import build
    from needlehoop.envs.controllers import controller
    from needlehoop.pictures.film import record

    cams = settings.cams or ("rgb_default", "dep_front", "seg_side")
    simulation = build(replace(settings, cams=cams, num_envs=1))
    record(simulation, controller(who, settings), asked.video_episodes, options.video)
    if not options.json:
        print(f"video: {options.video}")


def _grasps(grasps: tuple[str, ...] | None, options: argparse.Namespace) -> tuple[str, ...]:
    """Those that ``grasps`` names; by default all, or none where ``episode.grasp=`` names one."""
    from needlehoop.tasks.layout import GRASPS

    typed = [word for word in options.overrides if word.startswith("episode.grasp=")]
    if grasps is None:
        return () if typed else GRASPS
    if typed:
        raise ValueError(f"grasps: {typed[0]} names one already; give only one of them")
    strict.check_names("grasps", grasps, GRASPS)
    if not grasps:
        raise ValueError(f"grasps: name one or more of {', '.join(GRASPS)}")
    return grasps


@command(KEYS, config="view")
def view(options: argparse.Namespace) -> None:
    """Watch in MuJoCo's interactive viewer."""
    settings, asked = environment(options, "view", controller=str)
    from needlehoop.pictures import window

    window.view(settings, asked.controller)


@command(KEYS, config="env")
def signals(options: argparse.Namespace) -> None:
    """Print the table of a task's signals."""
    settings, _ = environment(options)
    from needlehoop.scene.signals import describe

    print(describe(settings.definition.signals))


@command(argument("overrides", nargs="*", metavar="task_dir=<folder> | conf_dir=<folder>"))
def tasks(options: argparse.Namespace) -> None:
    """List the tasks: their facts, phases, controllers and variants."""
    from needlehoop.config.options import variants
    from needlehoop.config.own_folder import KEY, TASK_KEY, part, task_folder
    from needlehoop.runs.shipped import CONF
    from needlehoop.tasks.registry import add_folder, find, names

    for key in (word.partition("=")[0] for word in options.overrides):
        if key not in (KEY, TASK_KEY):
            raise ValueError(f"{key}: unknown key; choose from {KEY}, {TASK_KEY}")
    _, folders = part(options.overrides)
    if own := task_folder(options.overrides):
        add_folder(own)
    for name in names():
        task = find(name)
        print(f"{name}: {task.summary}")
        for fact in task.facts:
            row = task.signals[fact.name]
            told = " (kept from reward writers)" if row.source == "verdict" else ""
            print(f"  fact        {fact.name}: {row.meaning}{told}")
        print(f"  phases      {', then '.join(f'{p.name} until {p.ends}' for p in task.phases)}")
        print(f"  controllers {', '.join(task.controllers)}; {task.teacher} is imitated")
        print(f"  variants    {', '.join(variants(name, [CONF, *folders]))}")


@command(KEYS, config="export")
def export(options: argparse.Namespace) -> None:
    """Write the arm, or the whole scene, as MJCF and meshes that MuJoCo opens by itself; or a
    trained policy as ONNX.
    """
    kinds = dict.fromkeys(("format", "run", "out"), str | None)
    what = Annotated[str, OneOf(*_SPECS, "policy")]
    settings, asked = environment(options, "export", what=what, overwrite=bool, **kinds)
    what, written = asked.what, "onnx" if asked.what == "policy" else "mjcf"
    if asked.format not in (None, written):
        raise ValueError(
            f"format: {asked.format!r} is unknown; what={what} is written as {written}"
        )
    if what == "policy":
        _export_policy(asked)
        return
    if asked.run is not None:
        raise ValueError(f"run: what={what} is of no run; it goes with what=policy")
    from needlehoop.scene.export import check_place, mjcf, papers, write_folder

    out = Path(asked.out or "psm")
    check_place(out, asked.overwrite)
    name, spec = _SPECS[what]
    write_folder(out, {**mjcf(spec(settings), name), **papers()})
    print(f"{out / name}.xml; look at it: python -m mujoco.viewer --mjcf={out / name}.xml")


def _export_policy(asked: Any) -> None:
    from needlehoop.runs.files import write_whole
    from needlehoop.runs.shipped import AGENT

    out = new_file(asked.out or "policy.onnx", ".onnx", asked.overwrite)
    from needlehoop.api.trained import actor_in
    from needlehoop.learning.policy import PRECISION, onnx_bytes

    spec, actor, origin = actor_in(asked.run or AGENT, "cpu", precision=PRECISION)
    content = onnx_bytes(spec, actor)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, content)
    print(f"{out}: {len(content) / 1e6:.1f} MB, {origin}; look at it: https://netron.app")


def _arm(settings: Any) -> Any:
    """The arm alone, with the keyframe ``home``."""
    import numpy as np

    from needlehoop.robot.psm import HOME, poser
    from needlehoop.tasks.layout import ArmLayout
    from needlehoop.tasks.psm import build_arm

    if not isinstance(settings.task, ArmLayout):
        raise ValueError(f"what: {settings.task.name} has no PSM; choose scene")
    spec = build_arm(settings.task, settings.psm)
    model = spec.compile()
    qpos = model.qpos0[None].copy()
    poser(model)(qpos, np.array([HOME]), np.zeros(1))
    spec.add_key(name="home", qpos=qpos[0], ctrl=[*HOME, 0.0])
    return spec


def _scene(settings: Any) -> Any:
    """The scene with every camera; ``home`` is the nominal start of an episode."""
    import torch

    from needlehoop.engines.addresses import Addresses
    from needlehoop.envs.build import scene_spec
    from needlehoop.tasks.start import NUMBERS, Chance

    spec = scene_spec(settings)
    task = settings.definition
    middle = torch.full((1, NUMBERS), 0.5, dtype=torch.float64)
    begun = task.start(settings.task, Chance(middle))
    found = Addresses(spec.compile(), task.robot).state(begun)
    qpos, mocap, ctrl = (found[name][0] for name in ("qpos", "mocap_pos", "ctrl"))
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl, mpos=mocap.ravel())
    return spec


_SPECS = {"arm": ("psm", _arm), "scene": ("scene", _scene)}
"""What is exported as MJCF: the file's name, and what makes the spec."""
