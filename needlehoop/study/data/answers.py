"""What a VLM said: answers to questions, orders of camera sets, and its reasons."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
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
    """Neighbours in an order: the better, the worse, and the probability that the model stated."""


@dataclass(frozen=True)
class Answers:
    """All that a model said about cameras."""

    source: str
    questions: Sequence[Answer] = ()
    rankings: Sequence[Ranking] = ()


def read_answers(folder: Path, rankings: str = RANKINGS) -> Answers | None:
    """A model's answers, as ``needlehoop vlm question`` and ``rank`` write them, if any."""
    replies = [json.loads(path.read_text(encoding="utf-8"))
               for name in (QUESTIONS, rankings) if (path := folder / name).exists()]  # fmt: skip
    rows = [as_rows(reply["answers"], reply["asked"]) for reply in replies if "answers" in reply]
    lists = [_ranking(record) for reply in replies for record in reply.get("lists", ())]
    models = dict.fromkeys(model for reply in replies for model in reply["models"])
    return Answers(", ".join(models), [*chain(*rows)], lists) if replies else None


def _ranking(record: Mapping[str, Any]) -> Ranking:
    """A list of ``rankings.json``: each of its samples is an order, the best first."""
    orders = [[place["name"] for place in sample] for sample in record["rankings"]]
    places = {name: sum(row.index(name) + 1 for row in orders) / len(orders) for name in orders[0]}
    pairs = (
        zip(order, order[1:], stated, strict=False)
        for order, stated in zip(orders, record.get("sure", ()), strict=False)
    )
    # Equal means stay in the order of the first sample.
    return Ranking(dict(sorted(places.items(), key=lambda item: item[1])), [*chain(*pairs)])


def as_rows(answers: Mapping[str, Any], words: Mapping[str, str]) -> list[Answer]:
    """The answers of ``questions.json`` in the order of Table I, and those of Appendix B.

    ``words``: facts in words; the model was asked which cameras show them.
    """
    facts = {**answers}
    parts, suits, layouts = (facts.pop(key) for key in ("subtasks", "suits", "layouts"))
    placements, _ = facts.pop("placements", {}), facts.pop("layouts_sure", None)
    both = [[parts[part][key] for part in ("first", "second")] for key in ("name", "description")]
    rows = [Answer("The task in two subtasks", *map("; ".join, both))]
    choices = {"for subtask 1": suits["first"], "for subtask 2": suits["second"]}
    choices["to see that the goal is reached"] = facts.pop("goal")
    choices |= {
        f"to see that {words.get(fact, f'it is {fact}')}": choice for fact, choice in facts.items()
    }
    rows += [
        Answer(f"Best {what} {purpose}", choice[what], choice[f"{what}_reason"])
        for purpose, choice in choices.items()
        for what in ("view", "rendering")
    ]
    best = layouts[0]
    rows.append(Answer("Best combination of views", best["name"].replace("_", " "), best["reason"]))
    for count, how_many in (("1", "one camera"), ("2", "two cameras")):
        if count in placements:
            best = placements[count]["places"][0]
            rows.append(Answer(f"Best placement of {how_many}", best["name"], best["reason"]))
    return rows
