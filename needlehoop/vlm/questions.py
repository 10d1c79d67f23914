"""The questions on cameras: which suit the task's parts, and how camera sets rank."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import parse_cameras
from needlehoop.vlm import description
from needlehoop.vlm.album import Album, states
from needlehoop.vlm.config import Samples
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import Subtasks, choice, choices, ranking
from needlehoop.vlm.prompts import fill, questioned
from needlehoop.vlm.tables import agreement


@dataclass(frozen=True)
class Questions:
    """Values in ``conf/vlm_question.yaml``."""

    shown: tuple[str, ...]
    """Renderings to show and to choose from; the first question shows the first one alone."""
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


@dataclass(frozen=True)
class Lists:
    """Values in ``conf/vlm_rank.yaml``."""

    lists: tuple[tuple[str, ...], ...]
    """Lists of camera sets, such as ``dep_front+seg_side``; each list is ranked by itself."""
    samples: Samples
    """Conversations in which the lists are ranked."""

    def __post_init__(self) -> None:
        if not self.lists:
            raise ValueError("lists: there is nothing to rank")
        for sets in self.lists:
            if len(sets) < 2 or len(set(sets)) < len(sets):
                raise ValueError(f"lists: {list(sets)} must be two or more different sets")

    def check(self, settings: Settings, shown: Sequence[str]) -> None:
        """Raises ``ValueError`` for a camera that the questions do not show."""
        for sets in self.lists:
            for name in sets:
                try:
                    parse_cameras(name.split("+"), settings.views, shown)
                except ValueError as error:
                    raise ValueError(f"lists: {name}: {error}") from error


def question(
    conversation: Conversation, settings: Settings, album: Album, questions: Questions
) -> dict[str, Any]:
    """Put all questions, in one conversation; answers by question, as plain values.

    Args:
        conversation: a new one.
        settings: the scene.
        album: its pictures.
        questions: what to show and to offer.

    Raises:
        NoAnswerError: no usable answer to a question within its attempts.
        RefusalError: the model would not answer.
    """
    views, shown, task = list(settings.views), list(questions.shown), settings.definition
    cameras = [f"{rendering}_{view}" for rendering in shown for view in views]
    opening = fill(
        "subtasks",
        scene=description.scene(settings),
        cameras=description.cameras(settings, shown),
    )
    first = [*album.show("start", cameras[: len(views)]), *album.show_seen(cameras[0])]
    subtasks = conversation.ask([opening, *first], Subtasks)
    # Some moments have a question of their own, and are shown there.
    own = questioned(task)
    stages = [state for state in states(task) if state not in own]
    everything = [part for state in stages for part in album.show(state, cameras)]
    suits = conversation.ask([fill("suits", task), *everything], choices(views, shown))
    goal = conversation.ask([fill("goal", task)], choice(views, shown))
    moments = {
        fact: conversation.ask(
            [fill(fact, task), *album.show(fact, cameras)], choice(views, shown)
        ).model_dump()
        for fact in own
    }
    layouts = conversation.ask(
        [fill("layouts", layouts=description.bullets(questions.layouts))],
        ranking(list(questions.layouts)),
    )
    return {
        "subtasks": subtasks.model_dump(),
        "suits": suits.model_dump(),
        "goal": goal.model_dump(),
        **moments,
        "layouts": layouts.model_dump()["places"],
    }


def rank(begin: Callable[[int], Conversation], lists: Lists) -> list[dict[str, Any]]:
    """Rank the lists in one or more conversations.

    Args:
        begin: gives the conversation of a sample (1, 2, …) in which ``question`` is done.
        lists: what to rank, and how often.

    Returns:
        For each list its camera sets (``combinations``), the rankings by sample, each the sets
        as ``name`` and ``reason``, best first, and how far the rankings agree.

    Raises:
        NoAnswerError: no usable answer to a question within its attempts.
        RefusalError: the model would not answer.
    """
    samples = [_rank_lists(begin(number), lists) for number in range(1, lists.samples + 1)]
    return [
        {
            "combinations": list(sets),
            "rankings": list(rankings),
            "agreement": agreement([[entry["name"] for entry in places] for places in rankings]),
        }
        for sets, *rankings in zip(lists.lists, *samples, strict=True)
    ]


def _rank_lists(conversation: Conversation, lists: Lists) -> list[list[dict[str, str]]]:
    ranked = []
    for sets in lists.lists:
        prompt = fill("rank", combinations="\n".join(f"- {name}" for name in sets))
        answer = conversation.ask([prompt], ranking(sets))
        ranked.append(answer.model_dump()["places"])
    return ranked
