"""The paper's published numbers and answers, and names of rewards and lists."""

from __future__ import annotations

import csv

from needlehoop.runs.files import EXPERT
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF, RECORDINGS
from needlehoop.study.data.answers import Answer, Answers, Ranking

SOURCE = "the paper's VLM"

HUMAN = "human"
"""The reward of the paper's first comparison."""

REWARDS = {
    "human": "human",
    "vlm_text": "VLM, text",
    "vlm_img": "VLM, text + image",
    "vlm_text_claude": "claude, text",
    "vlm_img_claude": "claude, text + image",
    EXPERT: "none: an expert was imitated",
}
"""Names of rewards for people; other rewards go by their own name."""

LISTS = {
    "rgb_dep": "RGB and depth",
    "rgb_seg": "RGB and segmentation",
    "dep_seg": "Depth and segmentation",
}
"""The paper's three lists of camera sets, in its order."""


def reward_label(reward: str) -> str:
    """A reward's name for people; after a comma, the label of runs that have one."""
    name, _, differs = reward.partition("+")
    return ", ".join([REWARDS.get(name, name), *([differs] if differs else [])])


def reward_order(reward: str) -> tuple[int, str]:
    """A key for sorting: the human reward first, then those of ``REWARDS``, then others."""
    known, name = [*REWARDS], reward.partition("+")[0]
    return (known.index(name) if name in known else len(known), reward)


def task() -> str:
    """The name of its task, which is the one that is chosen where none is named."""
    return read_yaml(CONF / "task/standard.yaml")["name"]


def measured() -> dict[str, float]:
    """Returns of Table II by camera set, with the human reward."""
    return {row["cameras"]: float(row["measured_return"]) for row in rows("table_2.csv")}


def lists() -> dict[str, tuple[str, ...]]:
    """The camera sets of each of the three lists, the best measured first."""
    found: dict[str, tuple[str, ...]] = {}
    for row in rows("table_2.csv"):
        found[row["list"]] = (*found.get(row["list"], ()), row["cameras"])
    return found


def answers() -> Answers:
    """Table I, and the predicted orders of Table II."""
    predicted = rows("table_2.csv")
    rankings = []
    for name in lists():
        own = [row for row in predicted if row["list"] == name]
        places = {row["cameras"]: float(row["predicted_rank"]) for row in own}
        rankings.append(Ranking(dict(sorted(places.items(), key=lambda item: item[1])), {}))
    questions = [Answer(row["question"], row["answer"], "") for row in rows("table_1.csv")]
    return Answers(SOURCE, tuple(questions), tuple(rankings))


def rewards() -> dict[tuple[str, str], tuple[float | None, str]]:
    """What is said of Figure 7 by camera set and reward; its curves were never published.

    That is the return of one run, ``None`` where there are words alone, and a remark.
    """
    return {
        (row["cameras"], row["reward"]): (
            float(row["measured_return"]) if row["measured_return"] else None,
            row["remark"],
        )
        for row in rows("figure_7.csv")
    }


def rows(name: str) -> list[dict[str, str]]:
    """A table of the recording ``paper``, row by row."""
    with (RECORDINGS / "paper" / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
