"""Reward programs: asked for, judged, and sent back with the reason until one is accepted."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.functions import FUNCTIONS
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

_RESULT = (
    "The program's value is what it last assigns to the variable reward. Assigned names may not be"
    " those of signals or functions."
)


@dataclass(frozen=True)
class Verdict:
    """Whether a program is accepted; ``reason`` is what the model is told of a refusal."""

    accepted: bool
    reason: str
    card: Mapping[str, Any]
    """Figures at the gates, for the record."""


@dataclass(frozen=True)
class ProgramRules:
    """The language of reward programs as a model is told it, and the judge of what it writes."""

    functions: Mapping[str, tuple[str, str]]
    """Signature and meaning by name."""
    result: str
    """One sentence on how a program gives its value."""
    lowest: float
    highest: float
    """The range that a program's value must keep to."""
    judge: Callable[[str], Verdict]
    values: Callable[[str], Sequence[float]]
    """An accepted program's value at each recorded moment."""


def program_rules(settings: Settings, gates: Gates) -> ProgramRules:
    """The language as it is compiled, with the gates as its judge.

    Args:
        settings: the environment in which the gates' trajectories are recorded, once.
        gates: what a program must pass.
    """
    trajectories, table = collect(settings, gates), settings.definition.signals

    def judge(source: str) -> Verdict:
        try:
            program = compile_program(source, table)
        except ProgramError as error:
            return Verdict(False, str(error), {})
        found = card(program, settings, gates, trajectories)
        # Naming the cheat, or where the teacher stopped, would tell the model what success is.
        named = {settings.definition.cheating: "an episode that fails at the task"}
        named |= {f"the teacher {how}": "an episode that stops short" for how in found.stopped}
        reason = "; ".join(found.reasons)
        for name, said in named.items():
            reason = reason.replace(name, said)
        return Verdict(found.passed, reason, found.as_dict())

    def values(source: str) -> list[float]:
        return values_of(compile_program(source, table), trajectories, gates).tolist()

    return ProgramRules(
        functions={name: (f.signature, f.meaning) for name, f in FUNCTIONS.items()},
        result=_RESULT,
        lowest=gates.low,
        highest=gates.high,
        judge=judge,
        values=values,
    )


@dataclass
class ProgramAttempts:
    """A conversation about one program, and what was found of each attempt."""

    conversation: Conversation
    verdicts: dict[int, tuple[str, Verdict]] = field(default_factory=dict)
    """Program and verdict by the number of the attempt, from 0."""

    @property
    def card(self) -> Mapping[str, Any]:
        """The last judged program's figures."""
        return self.verdicts[max(self.verdicts)][1].card

    def rows(self) -> list[dict[str, Any]]:
        """All attempts as plain values, those in a wrong form included."""
        rows = []
        for number, attempt in enumerate(self.conversation.attempts):
            source, verdict = self.verdicts.get(number, (None, None))
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


def write_program(
    attempts: ProgramAttempts, prompt: list[Part], rules: ProgramRules, first: Sequence[Part] = ()
) -> str:
    """Ask for a program until one is accepted; its source.

    Args:
        attempts: a new conversation.
        prompt: of ``reward_prompt``.
        rules: the language and its judge.
        first: a question that comes before: what the task is taken to be.

    Raises:
        NoAnswerError: none was accepted within the conversation's attempts.
        RefusalError: the model would not answer.
    """
    conversation = attempts.conversation

    def judge(answer: ProgramAnswer) -> str | None:
        source = _bare(answer.program)
        verdict = rules.judge(source)
        attempts.verdicts[len(conversation.attempts)] = source, verdict
        return None if verdict.accepted else f"the program was refused: {verdict.reason}"

    if first:
        conversation.ask(first, Guess)
    return _bare(conversation.ask(prompt, ProgramAnswer, judge).program)


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
        rules: the language.
        flavour: ``text`` or ``image``.
        album: needed for ``image``.
        told: ``full``; ``names``: signals with their ranges, and no word of the task; ``nothing``:
            the same after ``guess_prompt``, which has the pictures.
    """
    asked = {
        "lowest": f"{rules.lowest:g}",
        "highest": f"{rules.highest:g}",
        "language": description.language(rules.functions, rules.result),
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
    return [text, *album.show(list(cameras), ["start"])]


def guess_prompt(settings: Settings, album: Album) -> list[Part]:
    """What asks a model, told nothing of the task, what it takes the task to be."""
    told = description.scene(settings, "names")
    said = fill("guess", told=told, stages=description.stages(settings, "nothing"))
    return [said, *album.show(settings.cams, names=description.stage_names(settings, "nothing"))]


def _bare(program: str) -> str:
    """The program without the fence that models put around code; one newline at its end."""
    fenced = re.fullmatch(r"\s*```[a-zA-Z]*\n(.*?)\n?```\s*", program, re.DOTALL)
    return (fenced.group(1) if fenced else program).strip() + "\n"
