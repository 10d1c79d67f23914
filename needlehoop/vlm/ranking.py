"""The ranking: in what order will sets of cameras do?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import parse_cameras
from needlehoop.vlm.asked import Samples
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import ranking
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.repeats import agreement


@dataclass(frozen=True)
class Lists:
    """Values in ``conf/vlm_rank.yaml``."""

    lists: tuple[tuple[str, ...], ...]
    """Each a list of sets of cameras, such as ``dep_front+seg_side``."""
    samples: Samples
    """Conversations in which the lists are ranked."""

    def __post_init__(self) -> None:
        if not self.lists:
            raise ValueError("lists: there is nothing to rank")
        for sets in self.lists:
            if len(sets) < 2 or len(set(sets)) < len(sets):
                raise ValueError(f"lists: {list(sets)} must be two or more different sets")

    def check(self, settings: Settings, shown: Sequence[str]) -> None:
        """Raises ``ValueError`` for a camera that the questioning does not show."""
        for sets in self.lists:
            for name in sets:
                try:
                    parse_cameras(name.split("+"), settings.views, shown)
                except ValueError as error:
                    raise ValueError(f"lists: {name}: {error}") from error


def rank_lists(conversation: Conversation, lists: Lists) -> list[list[dict[str, str]]]:
    """Go on with a questioning: each list's sets, best first, as ``name`` and ``reason``.

    Raises:
        NoAnswerError: an answer could not be used, however often its question was put.
        RefusalError: the model would not answer.
    """
    ranked = []
    for sets in lists.lists:
        prompt = fill("rank", combinations="\n".join(f"- {name}" for name in sets))
        answer = conversation.ask([prompt], ranking(sets))
        ranked.append(answer.model_dump()["places"])
    return ranked


def rank(begin: Callable[[int], Conversation], lists: Lists) -> list[dict[str, Any]]:
    """Rank the lists in one or more conversations.

    Args:
        begin: the conversation of a sample (1, 2, …), with its questioning done.
        lists: what to rank, and how often.

    Returns:
        For each list its sets, the rankings by sample, and how far these agree.
    """
    samples = [rank_lists(begin(number), lists) for number in range(1, lists.samples + 1)]
    return [
        {
            "combinations": list(sets),
            "rankings": list(rankings),
            "agreement": agreement([[entry["name"] for entry in places] for places in rankings]),
        }
        for sets, *rankings in zip(lists.lists, *samples, strict=True)
    ]
