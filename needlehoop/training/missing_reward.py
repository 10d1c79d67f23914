"""Rewards that a model writes when a training needs them, and what the gates say of programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.envs.settings import Settings, settings_from
from needlehoop.rewards import written
from needlehoop.training.options import inquiry
from needlehoop.vlm.card import card
from needlehoop.vlm.config import Gates
from needlehoop.vlm.inquiry import Inquiry
from needlehoop.vlm.writing import ProgramRules, program_rules


def ask_where_missing(values: dict[str, Any], settings: Settings) -> None:
    """Have a model write the program of ``reward=vlm_img`` or ``vlm_text``, if none is recorded.

    It is kept in the study's folder, where the reward looks for it. ``vlm=replay`` is not asked:
    it has only what is recorded.

    Args:
        settings: its scene and cameras, with any reward.

    Raises:
        ValueError: no key, or a value that is not valid.
        RewardError: no reply, or no program that was accepted.
    """
    reward: Mapping[str, Any] = values["reward"]
    if values["vlm"]["kind"] == "replay" or written.is_recorded(reward):
        return
    asked, provider = inquiry(values)
    try:
        with Inquiry(settings, asked, provider) as opened:
            flavour, sample = written.FLAVOURS[reward["kind"]], reward["sample"]
            paths, _ = opened.reward(flavour, rules_of(values), sample)
    except RuntimeError as error:
        raise rewards.RewardError(f"reward: no program was written: {error}") from error
    print(f"reward written to {paths[-1]}")


def objections(values: Mapping[str, Any], settings: Settings) -> list[str]:
    """What the gates refuse or flag in the program that is the reward of a training.

    Empty for rewards that are no programs.
    """
    reward = rewards.load(settings.reward, settings.definition)
    if not isinstance(reward, written.Written):
        return []
    found = card(reward.program, settings, strict.as_type(values["gates"], Gates, "gates"))
    return [*(f"refused, {one}" for one in found.reasons), *found.flags]


def rules_of(values: Mapping[str, Any]) -> ProgramRules:
    """The language of rewards and its judge, for a composed config."""
    gates = strict.as_type(values["gates"], Gates, "gates")
    return program_rules(settings_from(dict(values)), gates)
