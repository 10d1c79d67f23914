"""The steps of needle and hoop, as its tests call them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import mujoco
import torch
from torch import Tensor

from needlehoop import rewards
from needlehoop.engines.engine import state_of
from needlehoop.envs.build import scene_spec
from needlehoop.envs.settings import Settings
from needlehoop.rewards.language import program
from needlehoop.scene.signals import Readings
from needlehoop.tasks import stepping
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.tasks.needle_hoop.scene import NeedleLayout
from needlehoop.tasks.start import Chance, Start
from needlehoop.vlm import moments

begin = partial(stepping.begin, TASK)
act = partial(stepping.act, TASK)


def row(*numbers: float) -> Tensor:
    """Numbers of one environment, ``(1, n)``."""
    return torch.tensor([numbers], dtype=torch.float64)


def start(layout: NeedleLayout, uniform: Tensor) -> Start:
    return TASK.start(layout, Chance(uniform))


def observe(layout, episode, memory, readings):
    """The memory from now on, the signals, and the grasp's weld (none by friction)."""
    memory, signals, _, welds = stepping.observe(TASK, layout, episode, memory, readings)
    return memory, signals, welds.get("grasp")


def spec_of(settings: Settings, psm: str) -> mujoco.MjSpec:
    """The scene, with either arm."""
    return scene_spec(replace(settings, psm=psm))


def begun_data(model: mujoco.MjModel, begun: Start) -> mujoco.MjData:
    """A scene where an episode begins; nothing is forwarded."""
    data = mujoco.MjData(model)
    for name, value in state_of(begun, model, TASK.robot.poser(model)).items():
        getattr(data, name)[:] = value[0]
    return data


def readings_of(model: mujoco.MjModel) -> Readings:
    return Readings(model, TASK.signals)


def load_reward(config):
    return rewards.load(config, TASK)


def compile_program(source):
    return program.compile_program(source, TASK.signals)


random_signals = partial(moments.random_signals, TASK)
