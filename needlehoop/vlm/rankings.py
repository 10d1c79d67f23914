"""Rankings put together: samples of one list, or groups of a list too long for one question."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from needlehoop.runs.files import csv_text

Ranked = dict[str, Any]
"""An answer, as ``conversation.ranking``: ``places``, best first, and how ``sure`` they are."""

_SEED = 0
"""Of the groups."""


def of_samples(names: Sequence[str], answers: Sequence[Ranked]) -> dict[str, Any]:
    """Several rankings of one list, its ``combinations``, and how far they agree.

    By sample: ``rankings``, each the names as ``name`` and ``reason``, best first, and ``sure``.
    """
    return {
        "combinations": list(names),
        "rankings": [answer["places"] for answer in answers],
        "sure": [answer["sure"] for answer in answers],
        "agreement": agreement(
            [[entry["name"] for entry in answer["places"]] for answer in answers]
        ),
    }


def of_groups(
    names: Sequence[str], size: int, rounds: int, answers: Sequence[Ranked]
) -> dict[str, Any]:
    """One ranking of a list of any length, from those of the groups of ``deal``.

    Each answer says for every two of its names which is better, or neither (a tie) where the model
    is sure of nothing between them (0.5). Bradley-Terry strengths are fitted to all of these.
    Beside what ``of_samples`` has are the ``scheme``, the ``strengths`` by name, and the
    ``questions`` as asked and answered.
    """
    found = strengths(names, answers)
    order = sorted(names, key=lambda name: (-found[name], names.index(name)))
    reasons: dict[str, str] = {}
    for answer in answers:
        for place in answer["places"]:
            reasons.setdefault(place["name"], place["reason"])
    whole = {
        "places": [{"name": name, "reason": reasons[name]} for name in order],
        "sure": [round(found[a] / (found[a] + found[b]), 4) for a, b in pairwise(order)],
    }
    asked = zip(deal(names, size, rounds), answers, strict=True)
    return {
        **of_samples(names, [whole]),
        "scheme": {"groups_of": size, "rounds": rounds, "seed": _SEED, "fit": "Bradley-Terry"},
        "strengths": found,
        "questions": [{"sets": dealt, **answer} for dealt, answer in asked],
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


def strengths(names: Sequence[str], answers: Sequence[Ranked]) -> dict[str, float]:
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
    for _ in range(500):
        met = (wins + wins.T) / (found[:, None] + found)
        found = (0.5 + wins.sum(1)) / (1 / (found + 1.0) + met.sum(1))
        found /= found.mean()
    return {name: round(float(found[number]), 6) for name, number in place.items()}


def agreement(orders: Sequence[Sequence[str]]) -> dict[str, float] | None:
    """How far orders of one list, the best first, agree; ``None`` for fewer than two.

    ``tau_b``: Kendall's, mean over all pairs. ``same_top``: share with the commonest first place.
    """
    if len(orders) < 2:
        return None
    names = list(orders[0])
    places = [[order.index(name) for name in names] for order in orders]
    taus = [float(kendalltau(a, b).statistic) for a, b in combinations(places, 2)]
    top = Counter(order[0] for order in orders).most_common(1)[0][1]
    return {"tau_b": sum(taus) / len(taus), "same_top": top / len(orders)}


def rankings_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``sample``, ``place`` (all from 1), ``cameras``, ``sure``, ``reason``.

    ``sure``: the stated probability that the set is better than the next; empty for the last.
    """
    rows = [
        (number, sample, place, entry["name"], sure, entry["reason"])
        for number, ranked in enumerate(lists, 1)
        for sample, (places, own) in enumerate(
            zip(ranked["rankings"], ranked["sure"], strict=True), 1
        )
        for place, (entry, sure) in enumerate(zip(places, (*own, ""), strict=True), 1)
    ]
    return csv_text(("list", "sample", "place", "cameras", "sure", "reason"), rows)


def agreement_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``samples``, ``tau_b``, ``same_top``; empty cells where there is one sample."""
    rows = []
    for number, ranked in enumerate(lists, 1):
        agreed = ranked["agreement"] or {"tau_b": "", "same_top": ""}
        rows.append((number, len(ranked["rankings"]), agreed["tau_b"], agreed["same_top"]))
    return csv_text(("list", "samples", "tau_b", "same_top"), rows)
