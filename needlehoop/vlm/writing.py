"""Reward programs: asked for, judged, and sent back with the reason until one is accepted."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from needlehoop.envs.settings import Settings
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import Program
from needlehoop.vlm.messages import Part
from needlehoop.vlm.prompts import fill


@dataclass(frozen=True)
class Verdict:
    """What became of a program; ``reason`` is what the model is told of a refusal."""

    accepted: bool
    reason: str
    card: Mapping[str, Any]
    """Figures, for the record."""


@dataclass(frozen=True)
class Workshop:
    """The language that rewards are written in, and who judges them."""

    functions: Mapping[str, tuple[str, str]]
    """Signature and meaning by name."""
    result: str
    """One sentence on how a program gives its value."""
    lowest: float
    highest: float
    """The range that a program's value must keep to."""
    judge: Callable[[str], Verdict]
    values: Callable[[str], Sequence[float]]
    """Of an accepted program, at each recorded moment."""


@dataclass
class Work:
    """The attempts at one program."""

    conversation: Conversation
    verdicts: dict[int, tuple[str, Verdict]] = field(default_factory=dict)
    """Program and verdict by the number of the attempt, from 0."""

    @property
    def card(self) -> Mapping[str, Any]:
        """The last judged program's figures."""
        return self.verdicts[max(self.verdicts)][1].card

    def attempts(self) -> list[dict[str, Any]]:
        """All attempts, those in a wrong form included, as plain values."""
        rows = []
        for number, attempt in enumerate(self.conversation.attempts):
            source, verdict = self.verdicts.get(number, (None, None))
            rows.append(
                {
                    "attempt": number + 1,
                    "request": attempt.exchange.sha256,
                    "answer": attempt.exchange.answer,
                    "program": source,
                    "accepted": attempt.reason is None,
                    "reason": attempt.reason,
                    "card": dict(verdict.card) if verdict else None,
                }
            )
        return rows


def write_program(work: Work, prompt: list[Part], workshop: Workshop) -> str:
    """Ask for a program until one is accepted; its source.

    Raises:
        NoAnswerError: none was accepted within the conversation's attempts.
        RefusalError: the model would not answer.
    """

    def judge(answer: Program) -> str | None:
        source = _bare(answer.program)
        verdict = workshop.judge(source)
        work.verdicts[len(work.conversation.attempts)] = source, verdict
        return None if verdict.accepted else f"the program was refused: {verdict.reason}"

    return _bare(work.conversation.ask(prompt, Program, judge).program)


def reward_prompt(
    settings: Settings, workshop: Workshop, flavour: str, album: Album | None = None
) -> list[Part]:
    """The text that asks for a program and, for ``image``, the cameras' start pictures.

    Args:
        settings: the scene, and the cameras to show.
        workshop: the language.
        flavour: ``text`` or ``image``.
        album: needed for ``image``.
    """
    text = fill(
        "reward",
        scene=description.scene(settings),
        lowest=f"{workshop.lowest:g}",
        highest=f"{workshop.highest:g}",
        signals=description.signals(settings),
        language=description.language(workshop.functions, workshop.result),
    )
    if flavour == "text":
        return [text]
    assert album is not None
    said = {
        camera.name: f"{description.view(settings.views[camera.view])};"
        f" {description.rendering(settings.renderings[camera.rendering])}"
        for camera in settings.cameras
    }
    pixels, listed = settings.image_size, description.bullets(said)
    text = fill("reward_images", reward=text, cameras=listed, pixels=pixels)
    return [text, *album.show("start", list(said)), *album.show_seen(next(iter(said)))]


def _bare(program: str) -> str:
    """The program without the fence that models put around code; one newline at its end."""
    fenced = re.fullmatch(r"\s*```[a-zA-Z]*\n(.*?)\n?```\s*", program, re.DOTALL)
    return (fenced.group(1) if fenced else program).strip() + "\n"
