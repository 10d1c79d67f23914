"""Lists too long for one question: asked about in groups, put together by Bradley-Terry."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np

_SEED = 0
"""Of the groups."""

_PASSES = 500


def rank_groups(
    ask: Callable[[int, Sequence[str]], dict[str, Any]],
    names: Sequence[str],
    group: int,
    rounds: int,
) -> dict[str, Any]:
    """Rank a list of any length.

    In each round all names are shuffled and dealt into groups; each group is ranked by itself. Each
    answer says for every two of its names which is better, or neither (a tie) where the model is
    sure of nothing between them (0.5). Bradley-Terry strengths are fitted to all of these.

    Args:
        ask: ranks a group: ``places`` and ``sure``; for a question that counts from 1.
        names: the list.
        group: names in one question, at most.
        rounds: questions about each name.

    Returns:
        As one list of ``questions.rank``: ``combinations``, ``rankings``, ``sure``, ``agreement``;
        and ``scheme``, ``strengths`` by name and ``questions``, as asked and answered.
    """
    groups = deal(names, group, rounds)
    answers = [ask(number, dealt) for number, dealt in enumerate(groups, 1)]
    found = strengths(names, answers)
    order = sorted(names, key=lambda name: (-found[name], names.index(name)))
    reasons: dict[str, str] = {}
    for answer in answers:
        for place in answer["places"]:
            reasons.setdefault(place["name"], place["reason"])
    return {
        "combinations": list(names),
        "rankings": [[{"name": name, "reason": reasons[name]} for name in order]],
        "sure": [[round(found[a] / (found[a] + found[b]), 4) for a, b in pairwise(order)]],
        "agreement": None,
        "scheme": {
            "groups_of": group,
            "rounds": rounds,
            "seed": _SEED,
            "fit": "Bradley-Terry",
        },
        "strengths": found,
        "questions": [
            {"sets": dealt, **answer} for dealt, answer in zip(groups, answers, strict=True)
        ],
    }


def deal(names: Sequence[str], size: int, rounds: int) -> list[list[str]]:
    """Groups of at most ``size``, as even as can be: each name is in one of every round."""
    if len(names) <= size:
        return [list(names)]
    draw, count = random.Random(_SEED), -(-len(names) // size)
    found = []
    for _ in range(rounds):
        shuffled = draw.sample(list(names), len(names))
        found += [shuffled[first::count] for first in range(count)]
    return found


def strengths(names: Sequence[str], answers: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Bradley-Terry strengths, of mean 1, by name; equal for names that nothing tells apart.

    Each name also has one tie with an average one, so that winning always has no strength without
    end.
    """
    place = {name: number for number, name in enumerate(names)}
    wins = np.zeros((len(names), len(names)))
    for answer in answers:
        order = [place[entry["name"]] for entry in answer["places"]]
        for first, second in combinations(range(len(order)), 2):
            tied = all(one == 0.5 for one in answer["sure"][first:second])
            wins[order[first], order[second]] += 0.5 if tied else 1.0
            wins[order[second], order[first]] += 0.5 if tied else 0.0
    found = np.ones(len(names))
    for _ in range(_PASSES):
        met = (wins + wins.T) / (found[:, None] + found)
        found = (0.5 + wins.sum(1)) / (1 / (found + 1.0) + met.sum(1))
        found /= found.mean()
    return {name: round(float(found[number]), 6) for name, number in place.items()}
