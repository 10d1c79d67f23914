"""Reward programs: asked for, judged, and sent back with the reason until one is accepted."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from scipy.stats import rankdata

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.program import compile_program
from needlehoop.rewards.written import FIRST
from needlehoop.study.render.table import Column, Table
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.card import card, values_of
from needlehoop.vlm.config import Gates
from needlehoop.vlm.conversation import Conversation, Guess, ProgramAnswer, Verdict
from needlehoop.vlm.messages import Part
from needlehoop.vlm.moments import collect
from needlehoop.vlm.prompts import fill, telling_of


@dataclass(frozen=True)
class ProgramRules:
    """What a program must keep to, and the judge of what a model writes."""

    lowest: float
    highest: float
    """The range that a program's value must keep to."""
    judge: Callable[[str], Verdict]
    values: Callable[[str], Sequence[float]]
    """An accepted program's value at each recorded moment."""


def program_rules(settings: Settings, gates: Gates) -> ProgramRules:
    """The rules with the gates as their judge, whose trajectories are recorded here, once."""
    trajectories, table = collect(settings, gates), settings.definition.signals

    def judge(source: str) -> Verdict:
        try:
            program = compile_program(source, table)
        except ProgramError as error:
            return Verdict(str(error), {})
        found = card(program, settings, gates, trajectories)
        # Naming the cheat, or where the teacher stopped, would tell the model what success is.
        named = {settings.definition.cheating: "an episode that fails at the task"}
        named |= {f"the teacher {how}": "an episode that stops short" for how in found.stopped}
        reason = "; ".join(found.reasons)
        for name, said in named.items():
            reason = reason.replace(name, said)
        return Verdict(reason or None, found.as_dict())

    def values(source: str) -> list[float]:
        return values_of(compile_program(source, table), trajectories.moments, gates).tolist()

    return ProgramRules(gates.low, gates.high, judge, values)


def write_program(
    conversation: Conversation, rules: ProgramRules, prompt: list[Part], first: Sequence[Part] = ()
) -> tuple[str, Verdict]:
    """Ask for a program until one is accepted; its source, and what was found of it.

    Args:
        conversation: a new one.
        rules: the judge.
        prompt: of ``reward_prompt``.
        first: a question that comes before: what the task is taken to be.

    Raises:
        NoAnswerError: none was accepted within the conversation's attempts.
        RefusalError: the model would not answer.
    """

    def judge(answer: ProgramAnswer) -> Verdict:
        reason, card = rules.judge(_bare(answer.program))
        return Verdict(reason and f"the program was refused: {reason}", card)

    if first:
        conversation.ask(first, Guess)
    answer = conversation.ask(prompt, ProgramAnswer, judge)
    return _bare(answer.program), conversation.attempts[-1].verdict


def rows_of(conversation: Conversation) -> list[dict[str, Any]]:
    """All answers of a conversation about a program as plain values, whatever their form."""
    rows = []
    for number, attempt in enumerate(conversation.attempts, 1):
        answer, verdict = attempt.answer, attempt.verdict
        is_program = isinstance(answer, ProgramAnswer)
        rows.append(
            {
                "attempt": number,
                "request": attempt.exchange.sha256,
                "answer": attempt.exchange.answer,
                "program": _bare(answer.program) if is_program else None,
                "accepted": is_program and verdict.reason is None,
                "reason": verdict.reason,
                "card": dict(verdict.card) if is_program else None,
            }
        )
    return rows


class Accepted(NamedTuple):
    """A program's figures at the gates, and its values at the recorded moments."""

    card: Mapping[str, Any]
    values: Sequence[float]


def compared(name: str, programs: Mapping[int, Accepted]) -> Table:
    """How several programs for the same cameras differ: one row each.

    Args:
        name: of the table's file.
        programs: by the number of the sample.
    """
    # A task without a cheat has no such figure.
    figures = [own.card for own in programs.values()]
    others = [to for to in ("random", "cheat") if figures[0][to] is not None]
    rows = [
        (
            number,
            *(own.card["expert"] - own.card[to] for to in others),
            own.card["paid"],
            *(_rho(own.values, other.values) for other in programs.values()),
        )
        for number, own in programs.items()
    ]
    columns = (
        Column("sample"),
        *(Column(f"expert - {to}", form=".3f") for to in others),
        Column("paid", "%", ".1f", 100.0),
        *(Column(f"rho with {number}", form=".3f") for number in programs),
    )
    note = (
        "rho: Spearman's, of the values over the recorded trajectories. Trained on: sample"
        f" {FIRST}, or that of reward.sample=."
    )
    return Table(name, "Samples compared", columns, tuple(rows), note)


def _rho(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Spearman's rank correlation; ``None`` where one side is constant."""
    x, y = (rankdata(side) - (len(side) + 1) / 2 for side in (a, b))
    size = math.sqrt(float((x**2).sum() * (y**2).sum()))
    return float((x * y).sum()) / size if size else None


def reward_prompt(
    settings: Settings,
    rules: ProgramRules,
    flavour: str,
    album: Album | None = None,
    told: str = "full",
) -> list[Part]:
    """The text that asks for a program and, for ``image``, the cameras' start pictures.

    Args:
        settings: the scene, and the cameras to show.
        rules: the range of values.
        flavour: ``text`` or ``image``.
        album: needed for ``image``.
        told: ``full``; ``names``: signals with their ranges, and no word of the task; ``nothing``:
            the same after ``guess_prompt``, which has the pictures.
    """
    asked = {
        "lowest": f"{rules.lowest:g}",
        "highest": f"{rules.highest:g}",
        "language": description.language(),
    }
    if told == "full":
        said, signals = description.scene(settings), description.signals(settings)
        text = fill("reward", settings.definition, scene=said, signals=signals, **asked)
    else:
        said = description.scene(settings, "nothing") if told == "names" else ""
        signals = description.unexplained(settings)
        text = fill("reward", scene=said, signals=signals, done="the task is done", **asked)
    if flavour == "text" or told == "nothing":
        return [text]
    assert album is not None
    telling = telling_of(settings.definition)
    cameras = {
        camera.name: f"{description.view(settings.views[camera.view], telling)};"
        f" {description.rendering(settings.renderings[camera.rendering], telling, settings.views)}"
        for camera in settings.cameras
    }
    pixels, listed = settings.image_size, description.bullets(cameras)
    text = fill("reward_images", reward=text, cameras=listed, pixels=pixels)
    return [text, *album.show(list(cameras), "start")]


def guess_prompt(settings: Settings, album: Album) -> list[Part]:
    """What asks a model, told nothing of the task, what it takes the task to be."""
    told = description.scene(settings, "names")
    said = fill("guess", told=told, stages=description.stages(settings, "nothing"))
    return [said, *album.named(description.stage_names(settings, "nothing")).show(settings.cams)]


def _bare(program: str) -> str:
    """The program without the fence that models put around code; one newline at its end."""
    fenced = re.fullmatch(r"\s*```[a-zA-Z]*\n(.*?)\n?```\s*", program, re.DOTALL)
    return (fenced.group(1) if fenced else program).strip() + "\n"
