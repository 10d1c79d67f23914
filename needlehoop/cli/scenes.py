"""Commands that show tasks and their scenes, or write them for other programs; the studio."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from needlehoop.cli.command import KEYS, beside_a_run, command, environment, new_file
from needlehoop.config.options import part, typed, variants
from needlehoop.config.strict import Amount, OneOf, Pixels, Range
from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import import_extra
from needlehoop.runs.shipped import AGENT, CONF

Levels = dict[str, dict[str, tuple[Amount, ...]]]
"""Amounts at severities 1, 2, … by axis, by group: ``conf/levels``."""


@command(KEYS, config="snapshot")
def snapshot(options: argparse.Namespace) -> None:
    """Write a contact sheet of all views and renderings, start and goal."""
    flags = dict.fromkeys(("overwrite", "tiles", "raw", "disturbed"), bool)
    settings, keys = environment(options, "snapshot", out=str, size=Pixels, levels=Levels, **flags)
    if keys.tiles and Path(keys.out).suffix:
        raise ValueError(f"out: {keys.out!r}; tiles=true writes a folder")
    out = new_file(keys.out, "" if keys.tiles else ".png", keys.overwrite)
    from needlehoop.pictures import stills

    if keys.tiles:
        images = {out / f"{name}.png": image for name, image in stills.tiles(settings).items()}
    elif keys.disturbed:
        images = {out: stills.disturbed_sheet(settings, keys.levels, keys.size)}
    else:
        images = {out: stills.contact_sheet(settings, keys.size, keys.raw)}
    for path, image in images.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        image.save(path)
        print(f"{path}: {image.width} x {image.height} px")


@command(KEYS, config="env")
def tasks(options: argparse.Namespace) -> None:
    """List the tasks: their facts, phases, controllers and variants.

    With task=<a variant> or task_dir=, that task alone, with the table of its signals.
    """
    from needlehoop.tasks.registry import find, names

    settings, _ = environment(options)
    is_one = any(typed(options.overrides, key) for key in ("task", "task_dir"))
    _, folders = part(options.overrides)
    for name in [settings.definition.name] if is_one else names():
        task = find(name)
        print(f"{name}: {task.summary}")
        for fact in task.facts:
            row = task.signals[fact.name]
            kept = " (kept from reward writers)" if row.source == "verdict" else ""
            print(f"  fact        {fact.name}: {row.meaning}{kept}")
        print(f"  phases      {', then '.join(f'{p.name} until {p.ends}' for p in task.phases)}")
        print(f"  controllers {', '.join(task.controllers)}; {task.teacher} is imitated")
        print(f"  variants    {', '.join(variants(name, [CONF, *folders]))}")
    if is_one:
        from needlehoop.scene.signals import describe

        print(f"\n{describe(settings.definition.signals)}")


@command(KEYS, config="export")
def export(options: argparse.Namespace) -> None:
    """Write the arm, or the whole scene, as MJCF and meshes that MuJoCo opens by itself; or a
    trained policy as ONNX.
    """
    what = Annotated[str, OneOf(*_SPECS, "policy")]
    kinds = {"what": what, "overwrite": bool, "run": str | None, "out": str | None}
    settings, keys = environment(options, "export", **kinds)
    if keys.what == "policy":
        _export_policy(keys)
        return
    from needlehoop.scene.export import mjcf, papers, write_folder

    out = Path(keys.out or "psm")
    name, spec = _SPECS[keys.what]
    write_folder(out, {**mjcf(spec(settings), name), **papers()}, keys.overwrite)
    print(f"{out / name}.xml; look at it: python -m mujoco.viewer --mjcf={out / name}.xml")


def _export_policy(keys: Any) -> None:
    out = new_file(keys.out or "policy.onnx", ".onnx", keys.overwrite)
    from needlehoop.api.making import actor_in
    from needlehoop.learning.policy import PRECISION, onnx_bytes

    spec, actor, origin = actor_in(keys.run or AGENT, "cpu", precision=PRECISION)
    content = onnx_bytes(spec, actor)
    write_whole(out, content)
    print(f"{out}: {len(content) / 1e6:.1f} MB, {origin}; look at it: https://netron.app")


def _arm(settings: Any) -> Any:
    """The arm alone, its remote centre in the world's origin, with the keyframe ``home``."""
    import numpy as np

    from needlehoop.robot.psm import HOME, model_spec, poser
    from needlehoop.scene.spec import furnish
    from needlehoop.tasks.layout import ArmLayout

    if not isinstance(settings.task, ArmLayout):
        raise ValueError(f"what: {settings.task.name} does not have one PSM; choose scene")
    spec = model_spec(settings.psm, np.zeros(3), settings.task.grip)
    furnish(spec, settings.task.timestep)
    # All of it, from the tip to the motors.
    spec.stat.extent = 1.0
    spec.stat.center = [0.0, 0.35, 0.15]
    model = spec.compile()
    qpos = model.qpos0[None].copy()
    poser(model)(qpos, np.array([HOME]), np.zeros(1))
    spec.add_key(name="home", qpos=qpos[0], ctrl=[*HOME, 0.0])
    return spec


def _scene(settings: Any) -> Any:
    """The scene with every camera; ``home`` is the nominal start of an episode."""
    import torch

    from needlehoop.engines.engine import state_of
    from needlehoop.envs.build import scene_spec
    from needlehoop.tasks.start import NUMBERS, Chance

    spec, task = scene_spec(settings), settings.definition
    model = spec.compile()
    middle = torch.full((1, NUMBERS), 0.5, dtype=torch.float64)
    begun = task.start(settings.task, Chance(middle))
    state = state_of(begun, model, task.robot.poser(model))
    qpos, mocap, ctrl = (state[name][0] for name in ("qpos", "mocap_pos", "ctrl"))
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl, mpos=mocap.ravel())
    return spec


_SPECS = {"arm": ("psm", _arm), "scene": ("scene", _scene)}
"""What is exported as MJCF: the file's name, and what makes the spec."""


@command(KEYS, config="studio")
def studio(options: argparse.Namespace) -> None:
    """Place cameras on a page in the browser, see what the agent sees, watch it act.

    The page is http://127.0.0.1:8080. Views are saved into conf_dir=. Ctrl-C ends it.
    """
    import_extra("viser", "studio", "studio")
    kinds: dict[str, Any] = {"host": str, "port": Annotated[int, Range(0, 65_535)], "results": str}
    kinds |= {"run": str | None, "size": Pixels, "levels": Levels}
    keys, words = beside_a_run(options, "studio", **kinds)
    run = None if keys.run is None else Path(keys.run)
    import torch

    from needlehoop.envs.settings import Settings, compose_settings
    from needlehoop.learning.job import pick_device
    from needlehoop.learning.subject import flown_job
    from needlehoop.runs.run import Run
    from needlehoop.studio.page import Page, Source
    from needlehoop.studio.players import players
    from needlehoop.studio.world import World

    def scene(*changed: str) -> Settings:
        kept = [word for word in words if not (changed and word.startswith("task="))]
        if run is None:
            return compose_settings([*kept, *changed])
        return flown_job(Run.open(run, "run").config(), [*kept, *changed], keys.trust)[0].env

    # A policy of a few layers is fastest on one.
    torch.set_num_threads(1)
    settings = scene()
    _, folders = part(words)
    choices = players(settings, run, keys.trust, pick_device(keys.device))
    named = [camera.rendering for camera in settings.cameras]
    plain = sorted(settings.renderings, key=lambda name: settings.renderings[name].depth != "none")
    rendering, *_ = *named, *plain
    liked = ("last policy", "best policy", settings.definition.teacher, *choices)
    first = next(name for name in liked if name in choices)
    world = World(settings, choices, keys.levels, rendering, first, keys.size)
    names = variants(settings.task.name, [CONF, *folders])
    source = Source(
        layouts={"as given": scene} | {name: partial(scene, f"task={name}") for name in names},
        words=[w for w in words if not w.startswith(("cams=", "conf_dir="))],
        conf_dir=next(iter(typed(words, "conf_dir")), "my_conf"),
        results=keys.results,
    )
    page = Page(world, source, keys.host, keys.port)
    try:
        print("Ctrl-C ends it.", flush=True)
        page.run(settings.period)
    except KeyboardInterrupt:
        print("studio: closed")
    finally:
        page.close()
