"""What a VLM said: answers to questions, orders of camera sets, and its reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.study.data.records import LeftOut

QUESTIONS, RANKINGS = "questions.json", "rankings.json"
LESS = {
    "afresh": "rankings_afresh.json",
    "only names told": "rankings_names.json",
    "nothing told": "rankings_nothing.json",
}
"""Rankings that do not follow the questions on cameras; by how they were asked for."""

VLM = "vlm"
"""Where a study keeps them."""

_NO_FACTS = ("subtasks", "suits", "goal", "layouts", "layouts_sure", "placements")
"""Answers that every task has; the others are each about a fact."""


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
    reasons: Mapping[str, str]
    """By camera set; empty where none were given."""
    sure: tuple[tuple[str, str, float], ...] = ()
    """Of neighbours in an order, the better one, the other, and the stated probability of that."""


@dataclass(frozen=True)
class Answers:
    """All that a model said about cameras."""

    source: str
    """Who said it."""
    questions: tuple[Answer, ...] = ()
    rankings: tuple[Ranking, ...] = ()


def read_answers(
    folder: Path, within: str = VLM, rankings: str = RANKINGS
) -> tuple[Answers | None, list[LeftOut]]:
    """A study's answers, as ``needlehoop vlm question`` and ``rank`` write them.

    Args:
        folder: the study's.
        within: the folder in it that has the files.
        rankings: the file of the rankings.

    Returns:
        The answers, or ``None`` where there are none that can be read; what was left out.
    """
    left_out: list[LeftOut] = []
    questions: tuple[Answer, ...] = ()
    ranked: tuple[Ranking, ...] = ()
    models: list[str] = []
    for name in (Path(within) / QUESTIONS, Path(within) / rankings):
        if not (folder / name).exists():
            continue
        try:
            found = read_json(folder / name, within=folder)
            if name.name == QUESTIONS:
                asked = _part(found, "asked", dict) if "asked" in found else {}
                questions = as_rows(_part(found, "answers", dict), asked)
            else:
                ranked = tuple(_ranking(entry) for entry in _part(found, "lists", list))
            models += [model for model in _part(found, "models", list) if model not in models]
        except UnreadableError as error:
            left_out.append(LeftOut(name, str(error)))
    if not questions and not ranked:
        return None, left_out
    return Answers(", ".join(map(str, models)), questions, ranked), left_out


def as_rows(
    answers: Mapping[str, Any], asked: Mapping[str, str] = MappingProxyType({})
) -> tuple[Answer, ...]:
    """The answers in the order of Table I, and those that it leaves to Appendix B.

    Args:
        answers: as in ``questions.json``.
        asked: facts in words: cameras were asked for that show them.

    Raises:
        UnreadableError: one is missing or of another form.
    """
    subtasks, suits = _part(answers, "subtasks", dict), _part(answers, "suits", dict)
    parts = [_part(subtasks, part, dict) for part in ("first", "second")]
    said = [
        Answer(
            "The task in two subtasks",
            "; ".join(_part(part, "name", str) for part in parts),
            "; ".join(_part(part, "description", str) for part in parts),
        )
    ]
    for number, part in enumerate(("first", "second"), start=1):
        said += _choice(_part(suits, part, dict), f"for subtask {number}")
    said += _choice(_part(answers, "goal", dict), "to see that the goal is reached")
    for fact in (key for key in answers if key not in _NO_FACTS):
        so = _part(asked, fact, str) if fact in asked else f"it is {fact}"
        said += _choice(_part(answers, fact, dict), f"to see that {so}")
    layouts = _ranked(_part(answers, "layouts", list))
    best = next(iter(layouts))
    said.append(Answer("Best combination of views", best.replace("_", " "), layouts[best]))
    placements = _part({"placements": {}, **answers}, "placements", dict)
    for count, how_many in (("1", "one camera"), ("2", "two cameras")):
        if count in placements:
            places = _ranked(_part(_part(placements, count, dict), "places", list))
            best = next(iter(places))
            said.append(Answer(f"Best placement of {how_many}", best, places[best]))
    return tuple(said)


def _choice(choice: Mapping[str, Any], purpose: str) -> list[Answer]:
    return [
        Answer(
            f"Best {what} {purpose}",
            _part(choice, what, str),
            _part(choice, f"{what}_reason", str),
        )
        for what in ("view", "rendering")
    ]


def _ranking(entry: Any) -> Ranking:
    """One list; the places are means over the samples, the reasons those of the first."""
    if not isinstance(entry, dict):
        raise UnreadableError("has an entry of lists without keys")
    samples = [_ranked(sample) for sample in _part(entry, "rankings", list)]
    stated = _part(entry, "sure", list) if "sure" in entry else [[]] * len(samples)
    if len(stated) != len(samples) or not all(isinstance(own, list) for own in stated):
        raise UnreadableError("has other probabilities than those of its rankings")
    if not samples or any(set(sample) != set(samples[0]) for sample in samples):
        raise UnreadableError("has rankings of one list that differ in what they rank")
    orders = [list(sample) for sample in samples]
    means = {
        name: sum(order.index(name) + 1 for order in orders) / len(orders) for name in orders[0]
    }
    sure = tuple(
        (first, second, _probability(own))
        for order, probabilities in zip(orders, stated, strict=True)
        for first, second, own in zip(order, order[1:], probabilities, strict=False)
    )
    return Ranking(dict(sorted(means.items(), key=lambda item: item[1])), samples[0], sure)


def _probability(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise UnreadableError("has a probability that is none")
    return float(value)


def _ranked(places: Sequence[Any]) -> dict[str, str]:
    """Reasons by name, the best first."""
    if not places or not all(isinstance(place, dict) for place in places):
        raise UnreadableError("has a ranking without places")
    reasons = {_part(place, "name", str): _part(place, "reason", str) for place in places}
    if len(reasons) < len(places):
        raise UnreadableError("has a ranking that names something twice")
    return reasons


def _part(entry: Mapping[str, Any], key: str, kind: type) -> Any:
    found = entry.get(key)
    if not isinstance(found, kind):
        raise UnreadableError(f"has no usable {key}")
    return found
