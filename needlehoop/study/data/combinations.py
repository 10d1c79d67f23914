"""Names of camera combinations, as people read them."""

from __future__ import annotations

import re

from needlehoop.runs.files import EXPERT

HUMAN = "human"
"""The reward of the paper's first comparison."""

REWARDS = {
    "human": "human",
    "vlm_text": "VLM, text",
    "vlm_img": "VLM, text + image",
    "vlm_text_claude": "claude, text",
    "vlm_img_claude": "claude, text + image",
    EXPERT: "none: an expert was imitated",
}
"""Rewards as the paper names them; others go by their own name."""

LISTS = {
    "rgb_dep": "RGB and depth",
    "rgb_seg": "RGB and segmentation",
    "dep_seg": "Depth and segmentation",
}
"""The paper's three lists, in its order."""

_CAMERA = re.compile(r"([a-z0-9]+)_([a-z0-9])\w*")


def label(cameras: str) -> str:
    """``dep_front+seg_side`` as the paper writes it: ``DEP (F) + SEG (S)``."""
    return " + ".join(_camera(name) for name in cameras.split("+"))


def reward_label(reward: str) -> str:
    """A reward's name for people."""
    return REWARDS.get(reward, reward)


def reward_order(reward: str) -> tuple[int, str]:
    """Sorts the human one first, then those of ``REWARDS``, then others by name."""
    known = [*REWARDS]
    return (known.index(reward) if reward in known else len(known), reward)


def _camera(name: str) -> str:
    found = _CAMERA.fullmatch(name)
    return f"{found[1].upper()} ({found[2].upper()})" if found else name
