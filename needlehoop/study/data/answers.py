"""What a VLM said: answers to questions, orders of camera sets, and its reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field

from needlehoop.runs.reading import UnreadableError, read_json
from needlehoop.study.data.contents import checked
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
    questions: tuple[Answer, ...] = ()
    rankings: tuple[Ranking, ...] = ()


class _Reasoned(BaseModel, strict=True):
    name: str
    reason: str


class _List(BaseModel, strict=True):
    """A list of ``rankings.json``: each sample is an order, the best first."""

    rankings: Annotated[list[list[_Reasoned]], Field(min_length=1)]
    sure: list[list[Annotated[float, Field(ge=0, le=1)]]] = []
    """Of each sample that states them, the probabilities of its neighbours."""

    def ranking(self) -> Ranking:
        """The places are means over the samples, the reasons those of the first."""
        orders = [[place.name for place in sample] for sample in self.rankings]
        names = [*dict.fromkeys(orders[0])]
        if not names or any(sorted(order) != sorted(names) for order in orders):
            raise UnreadableError("has rankings of one list that differ in what they rank")
        if self.sure and len(self.sure) != len(orders):
            raise UnreadableError("has no usable sure: not one for each ranking")
        means = {name: sum(own.index(name) + 1 for own in orders) / len(orders) for name in names}
        sure = tuple(
            pair
            for order, stated in zip(orders, self.sure, strict=False)
            for pair in zip(order, order[1:], stated, strict=False)
        )
        # Equal means stay in the order of the first sample.
        places = dict(sorted(means.items(), key=lambda item: item[1]))
        return Ranking(places, {one.name: one.reason for one in self.rankings[0]}, sure)


class _File(BaseModel):
    """Questions or rankings."""

    models: list[str]
    answers: dict[str, Any] | None = None
    asked: dict[str, str] = {}
    lists: list[_List] = []


def read_answers(
    folder: Path, within: str = VLM, rankings: str = RANKINGS
) -> tuple[Answers | None, list[LeftOut]]:
    """A study's answers, as ``needlehoop vlm question`` and ``rank`` write them.

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
            said: _File = checked(_File, read_json(folder / name))
            questions += as_rows(said.answers, said.asked) if said.answers is not None else ()
            ranked += tuple(one.ranking() for one in said.lists)
            models += said.models
        except UnreadableError as error:
            left_out.append(LeftOut(name, str(error)))
    if not questions and not ranked:
        return None, left_out
    return Answers(", ".join(dict.fromkeys(models)), questions, ranked), left_out


def as_rows(answers: Mapping[str, Any], asked: Mapping[str, str]) -> tuple[Answer, ...]:
    """The answers in the order of Table I, and those that it leaves to Appendix B.

    Args:
        answers: as in ``questions.json``.
        asked: facts in words: cameras were asked for that show them.

    Raises:
        UnreadableError: one is missing or of another form.
    """
    try:
        return checked(tuple[Answer, ...], [*_rows({**answers}, asked)])
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise UnreadableError(f"has no usable answers: {error!r}") from error


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
