"""The paper's published numbers and answers, as a data set of its own."""

from __future__ import annotations

import csv
from dataclasses import dataclass

from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data.answers import Answer, Answers, Ranking

FOLDER = RECORDINGS / "paper"
SOURCE = "the paper (Gemini 1.5 Flash)"


@dataclass(frozen=True)
class Reported:
    """A return that the paper reports for a combination and a reward, from one run."""

    cameras: str
    reward: str
    value: float | None
    """``None`` where there are words alone."""
    remark: str


def measured() -> dict[str, float]:
    """Returns of Table II by combination, with the human reward."""
    return {row["cameras"]: float(row["measured_return"]) for row in _rows("table_2.csv")}


def lists() -> dict[str, tuple[str, ...]]:
    """The combinations of each of the three lists, the best measured first."""
    found: dict[str, tuple[str, ...]] = {}
    for row in _rows("table_2.csv"):
        found[row["list"]] = (*found.get(row["list"], ()), row["cameras"])
    return found


def answers() -> Answers:
    """Table I, and the predicted orders of Table II."""
    rows = _rows("table_2.csv")
    rankings = []
    for name in lists():
        own = [row for row in rows if row["list"] == name]
        places = {row["cameras"]: float(row["predicted_rank"]) for row in own}
        rankings.append(Ranking(dict(sorted(places.items(), key=lambda item: item[1])), {}))
    questions = [Answer(row["question"], row["answer"], "") for row in _rows("table_1.csv")]
    return Answers(SOURCE, tuple(questions), tuple(rankings))


def rewards() -> list[Reported]:
    """What is said of Figure 7, in numbers and in words; its curves were never published."""
    return [
        Reported(
            row["cameras"],
            row["reward"],
            float(row["measured_return"]) if row["measured_return"] else None,
            row["remark"],
        )
        for row in _rows("figure_7.csv")
    ]


def _rows(name: str) -> list[dict[str, str]]:
    with (FOLDER / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
