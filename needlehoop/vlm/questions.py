"""The questioning: what suits which part of the task, and what shows how far it has come."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from needlehoop.envs.settings import Settings
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import Subtasks, choice, choices, ranking
from needlehoop.vlm.prompts import fill

_SHOWN = ("start", "grasped", "goal")
"""Before the question of what suits the subtasks; what is lifted comes with its own."""


@dataclass(frozen=True)
class Questions:
    """Values in ``conf/vlm_question.yaml``."""

    shown: tuple[str, ...]
    """Renderings to show and to choose from; the first alone for the first question."""
    layouts: Mapping[str, str]
    """Ways to place cameras, to be ranked: name and description."""

    def __post_init__(self) -> None:
        if len(self.shown) < 2 or len(set(self.shown)) < len(self.shown):
            raise ValueError(f"shown: {list(self.shown)} must be two or more different renderings")
        if len(self.layouts) < 2:
            raise ValueError("layouts: at least two are needed to rank them")

    def check(self, settings: Settings) -> None:
        """Raises ``ValueError`` for a rendering that the scene does not have."""
        for name in self.shown:
            if name not in settings.renderings:
                valid = ", ".join(settings.renderings)
                raise ValueError(f"shown: {name!r} is unknown; choose from {valid}")


def question(
    conversation: Conversation, settings: Settings, album: Album, questions: Questions
) -> dict[str, Any]:
    """Put all questions, in one conversation; answers by question, as plain values.

    Args:
        conversation: nothing has been said in it yet.
        settings: the scene.
        album: its pictures.
        questions: what to show and to offer.

    Raises:
        NoAnswerError: an answer could not be used, however often its question was put.
        RefusalError: the model would not answer.
    """
    views, shown = list(settings.views), list(questions.shown)
    cameras = [f"{rendering}_{view}" for rendering in shown for view in views]
    opening = fill(
        "subtasks",
        scene=description.scene(settings),
        cameras=description.cameras(settings, shown),
    )
    first = [*album.show("start", cameras[: len(views)]), *album.show_seen(cameras[0])]
    subtasks = conversation.ask([opening, *first], Subtasks)
    everything = [part for state in _SHOWN for part in album.show(state, cameras)]
    suits = conversation.ask([fill("suits"), *everything], choices(views, shown))
    goal = conversation.ask([fill("goal")], choice(views, shown))
    lifted = conversation.ask(
        [fill("lifted"), *album.show("lifted", cameras)], choice(views, shown)
    )
    layouts = conversation.ask(
        [fill("layouts", layouts=description.bullets(questions.layouts))],
        ranking(list(questions.layouts)),
    )
    return {
        "subtasks": subtasks.model_dump(),
        "suits": suits.model_dump(),
        "goal": goal.model_dump(),
        "lifted": lifted.model_dump(),
        "layouts": layouts.model_dump()["places"],
    }
