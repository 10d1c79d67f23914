"""What a VLM said: answers to questions, orders of camera sets, and its reasons."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

QUESTIONS, RANKINGS = "questions.json", "rankings.json"
LESS = {
    "afresh": "rankings_afresh.json",
    "only names told": "rankings_names.json",
    "nothing told": "rankings_nothing.json",
}
"""Rankings that do not follow the questions on cameras; by how they were asked for."""

VLM = "vlm"
"""Where a study keeps them."""


@dataclass(frozen=True)
class Answer:
    """A row of the paper's Table I."""

    question: str
    answer: str
    reason: str


@dataclass(frozen=True)
class Ranking:
    """A list of camera sets in the order that was predicted."""

    places: Mapping[str, float]
    """Place by camera set, the best (lowest) first; a mean where the model was asked repeatedly."""
    sure: Sequence[tuple[str, str, float]] = ()
    """Of neighbours in an order, the better one, the other, and the stated probability of that."""


@dataclass(frozen=True)
class Answers:
    """All that a model said about cameras."""

    source: str
    questions: Sequence[Answer] = ()
    rankings: Sequence[Ranking] = ()


def read_answers(folder: Path, rankings: str = RANKINGS) -> Answers | None:
    """A model's answers, as ``needlehoop vlm question`` and ``rank`` write them, if any."""
    said = [json.loads(path.read_text(encoding="utf-8"))
            for name in (QUESTIONS, rankings) if (path := folder / name).exists()]  # fmt: skip
    rows = [as_rows(one["answers"], one["asked"]) for one in said if "answers" in one]
    lists = [_ranking(one) for own in said for one in own.get("lists", ())]
    models = dict.fromkeys(model for one in said for model in one["models"])
    return Answers(", ".join(models), [*chain(*rows)], lists) if said else None


def _ranking(one: Mapping[str, Any]) -> Ranking:
    """A list of ``rankings.json``: each of its samples is an order, the best first."""
    orders = [[place["name"] for place in sample] for sample in one["rankings"]]
    places = {name: sum(own.index(name) + 1 for own in orders) / len(orders) for name in orders[0]}
    pairs = (
        zip(order, order[1:], stated, strict=False)
        for order, stated in zip(orders, one.get("sure", ()), strict=False)
    )
    # Equal means stay in the order of the first sample.
    return Ranking(dict(sorted(places.items(), key=lambda item: item[1])), [*chain(*pairs)])


def as_rows(answers: Mapping[str, Any], asked: Mapping[str, str]) -> tuple[Answer, ...]:
    """The answers in the order of Table I, and those that it leaves to Appendix B.

    Args:
        answers: as in ``questions.json``.
        asked: facts in words: cameras were asked for that show them.
    """
    return tuple(_rows({**answers}, asked))


def _rows(answers: dict[str, Any], asked: Mapping[str, str]) -> Iterator[Answer]:
    parts = answers.pop("subtasks")
    both = [[parts[part][key] for part in ("first", "second")] for key in ("name", "description")]
    yield Answer("The task in two subtasks", *map("; ".join, both))
    suits, layouts = answers.pop("suits"), answers.pop("layouts")
    placements = answers.pop("placements", {})
    answers.pop("layouts_sure", None)
    choices = {"for subtask 1": suits["first"], "for subtask 2": suits["second"]}
    choices["to see that the goal is reached"] = answers.pop("goal")
    # What is left are facts.
    choices |= {
        f"to see that {asked.get(fact, f'it is {fact}')}": own for fact, own in answers.items()
    }
    for purpose, choice in choices.items():
        for what in ("view", "rendering"):
            yield Answer(f"Best {what} {purpose}", choice[what], choice[f"{what}_reason"])
    best = layouts[0]
    yield Answer("Best combination of views", best["name"].replace("_", " "), best["reason"])
    for count, how_many in (("1", "one camera"), ("2", "two cameras")):
        if count in placements:
            best = placements[count]["places"][0]
            yield Answer(f"Best placement of {how_many}", best["name"], best["reason"])
