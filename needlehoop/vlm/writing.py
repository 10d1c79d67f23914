"""Reward programs: asked for, judged, and sent back with the reason until one is accepted."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.program import compile_program
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.card import card, values_of
from needlehoop.vlm.config import Gates
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import Guess, ProgramAnswer
from needlehoop.vlm.messages import Part
from needlehoop.vlm.moments import collect
from needlehoop.vlm.prompts import fill, telling_of


class Verdict(NamedTuple):
    """Why a program is refused, as the model is told; ``None``: it is accepted."""

    reason: str | None
    card: Mapping[str, Any]
    """Figures at the gates, for the record."""


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


class ProgramAttempts:
    """A conversation about one program, and what was found of each attempt."""

    def __init__(self, conversation: Conversation, rules: ProgramRules):
        self._conversation, self._rules = conversation, rules
        self._judged: dict[int, tuple[str, Verdict]] = {}
        """Program and verdict by the number of the attempt, from 0."""

    def write(self, prompt: list[Part], first: Sequence[Part] = ()) -> tuple[str, Verdict]:
        """Ask for a program until one is accepted; its source, and what was found of it.

        Args:
            prompt: of ``reward_prompt``.
            first: a question that comes before: what the task is taken to be.

        Raises:
            NoAnswerError: none was accepted within the conversation's attempts.
            RefusalError: the model would not answer.
        """
        if first:
            self._conversation.ask(first, Guess)
        self._conversation.ask(prompt, ProgramAnswer, self._judge)
        return self._judged[max(self._judged)]

    def _judge(self, answer: ProgramAnswer) -> str | None:
        source = _bare(answer.program)
        verdict = self._rules.judge(source)
        self._judged[len(self._conversation.attempts)] = source, verdict
        return None if verdict.reason is None else f"the program was refused: {verdict.reason}"

    def rows(self) -> list[dict[str, Any]]:
        """All attempts as plain values, those in a wrong form included."""
        rows = []
        for number, attempt in enumerate(self._conversation.attempts):
            source, verdict = self._judged.get(number, (None, None))
            rows.append(
                {
                    "attempt": number + 1,
                    "request": attempt.exchange.sha256,
                    "answer": attempt.exchange.answer,
                    "program": source,
                    "accepted": source is not None and attempt.reason is None,
                    "reason": attempt.reason,
                    "card": dict(verdict.card) if verdict else None,
                }
            )
        return rows


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
