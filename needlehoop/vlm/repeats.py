"""How far repeated rankings of one list agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations

from scipy.stats import kendalltau


def agreement(orders: Sequence[Sequence[str]]) -> dict[str, float] | None:
    """Agreement of rankings; ``None`` for fewer than two.

    Args:
        orders: permutations of one list, the best first.

    Returns:
        ``tau_b``: Kendall's, mean over all pairs of rankings; ``same_top``: share of the
        rankings whose first place is the commonest one.
    """
    if len(orders) < 2:
        return None
    names = list(orders[0])
    places = [[order.index(name) for name in names] for order in orders]
    taus = [float(kendalltau(a, b).statistic) for a, b in combinations(places, 2)]
    top = Counter(order[0] for order in orders).most_common(1)[0][1]
    return {"tau_b": sum(taus) / len(taus), "same_top": top / len(orders)}
