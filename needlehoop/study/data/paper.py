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
    return f"{REWARDS.get(name, name)}, {differs}" if differs else REWARDS.get(name, name)


def reward_order(reward: str) -> tuple[int, str]:
    """A key for sorting: the human reward first, then those of ``REWARDS``, then others."""
    known = [*REWARDS, name := reward.partition("+")[0]]
    return known.index(name), reward


def task() -> str:
    """The name of the paper's task, which is also the default task."""
    return read_yaml(CONF / "task/standard.yaml")["name"]


def measured() -> dict[str, float]:
    """Returns of Table II by camera set, with the human reward."""
    return {row["cameras"]: float(row["measured_return"]) for row in rows("table_2.csv")}


def lists() -> dict[str, list[str]]:
    """The camera sets of each of the three lists, the best measured first, by its label."""
    table = rows("table_2.csv")
    return {
        label: [row["cameras"] for row in table if row["list"] == name]
        for name, label in LISTS.items()
    }


def answers() -> Answers:
    """Table I, and the predicted orders of Table II."""
    predicted = sorted(rows("table_2.csv"), key=lambda row: float(row["predicted_rank"]))
    orders = (
        {row["cameras"]: float(row["predicted_rank"]) for row in predicted if row["list"] == name}
        for name in LISTS
    )
    questions = [Answer(row["question"], row["answer"], "") for row in rows("table_1.csv")]
    return Answers(SOURCE, questions, [*map(Ranking, orders)])


def rows(name: str) -> list[dict[str, str]]:
    """A table of the recording ``paper``, row by row."""
    with (RECORDINGS / "paper" / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
