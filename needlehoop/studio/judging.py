"""What cameras are worth: pixels of each thing, the probe's score, a question to a model."""

from __future__ import annotations

import hashlib
import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from needlehoop.config import composing
from needlehoop.config.strict import as_type
from needlehoop.disturbances.axes import Disturb
from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.engines.rasteriser.renderer import CpuRasteriser
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, rollout
from needlehoop.envs.images import things
from needlehoop.envs.settings import Settings
from needlehoop.probe import measuring
from needlehoop.probe.frames import quantities
from needlehoop.probe.measuring import Plan, Progress
from needlehoop.probe.scores import load
from needlehoop.vlm.config import InquiryConfig, ManualConfig
from needlehoop.vlm.inquiry import Inquiry
from needlehoop.vlm.providers import UnansweredError
from needlehoop.vlm.questions import Lists, Questions

_AWAY = 1000.0
"""Where things go that are not to be seen, m."""


class Shown(NamedTuple):
    """How a thing is seen, mean over an episode's moments."""

    pixels: float
    """Of the agent's image."""
    hidden: float
    """Share of its pixels that other things cover; NaN where it is never in the picture."""


def visibility(settings: Settings) -> dict[str, dict[str, Shown]]:
    """How each view shows each thing of the task, over the expert's episode: by view, then thing.

    Things are the classes of flat renderings.
    """
    env = replace(settings, num_envs=1, cams=(), disturb=Disturb())
    simulation = build(env)
    model, paint = simulation.engine.model, env.definition.paint
    part = things(model, paint)
    # By geom id plus one; nothing hit is -1.
    thing_of, numbers = np.concatenate(([0], part)), range(1, len(paint) + 1)
    channels = dict.fromkeys(env.views, Channels(False, False, True))
    # Scene 0 is whole; in scene k there is nothing but thing k.
    camera = CpuRasteriser(model, 1 + len(paint), channels, env.image_size, 1)
    counts: list[Any] = []
    for _ in rollout(simulation, controller("expert", env)):
        data = simulation.engine.data(0)
        fields = {
            name: torch.tensor(getattr(data, name)).expand(1 + len(paint), -1, -1).clone()
            for name in FIELDS
        }
        for k in numbers:
            fields["geom_xpos"][k, part != k] = _AWAY
        frames: Any = camera.render(fields)
        labels = [thing_of[frame.geom.numpy() + 1] for frame in frames.values()]
        counts.append(
            [[((label[0] == k).sum(), (label[k] == k).sum()) for k in numbers] for label in labels]
        )
    # By view and thing.
    pixels, alone = np.moveaxis(np.mean(counts, 0), -1, 0)
    with np.errstate(invalid="ignore"):
        hidden = 1.0 - pixels / alone
    return {
        view: {thing: Shown(pixels[v, t], hidden[v, t]) for t, thing in enumerate(paint)}
        for v, view in enumerate(channels)
    }


def probe_scores(
    settings: Settings,
    cams: tuple[str, ...],
    progress: Progress,
    **changes: Any,
) -> dict[str, float]:
    """The probe's score of each camera, and of all together, the best first; takes minutes.

    ``changes`` are to the plan of ``conf/probe.yaml``, such as ``episodes`` or ``fit``.
    """
    sets = tuple((name,) for name in cams) + ((cams,) if len(cams) > 1 else ())
    values = composing.compose((), "probe")
    plain = replace(settings, cams=(), disturb=Disturb())
    values |= {"env": plain, "camera_sets": sets, "seeds": 1, **changes}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        measuring.probe(as_type(values, Plan), folder, progress)
        results = load(folder, quantities(settings.definition))
    return {name: results.score(name).value for name in results.ranked}


def ranking_question(
    settings: Settings, cams: tuple[str, ...], results: str
) -> tuple[Path, list[str]]:
    """Write the question that asks a model to rank cameras, as ``vlm=manual`` does.

    It is kept below ``results``, the same cameras in the same place. Asked again, this reads the
    answer that was put beside it. Returns the question's folder, and the cameras from best to
    worst; none while there is no answer. ``ValueError``: fewer than two cameras, a task that is
    told to no model, or a wrong answer.
    """
    if len(cams) < 2:
        raise ValueError("cams: there is nothing to rank; show two views or more")
    env = replace(settings, num_envs=1, cams=(), disturb=Disturb())
    stands = {name: view.given for name, view in env.views.items()}
    identity = json.dumps([cams, stands, env.seed, str(env.task)], sort_keys=True)
    study = f"studio_{hashlib.sha256(identity.encode()).hexdigest()[:12]}"
    values = composing.compose((), "vlm_rank") | {"results": results, "study": study}
    config = as_type(values, InquiryConfig)
    lists = as_type({**values, "sets": (cams,), "group": max(5, len(cams))}, Lists)
    manual = ManualConfig("manual", "a person", wait=0.0, poll=0.05)
    with Inquiry(env, config, manual) as inquiry:
        try:
            result = inquiry.rank(as_type(values, Questions), lists)
        except UnansweredError:
            return config.folder, []
    return config.folder, [place["name"] for place in result["lists"][0]["rankings"][0]]
