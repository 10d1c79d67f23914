"""Q8 of docs/protocol.md: is imitation a stand-in for reinforcement learning?"""

from __future__ import annotations

from collections import Counter
from itertools import permutations, product

import numpy as np
import pandas as pd

from analysis.protocol import Scores, mean_tau, means
from analysis.runs import is_two_sided
from needlehoop.study.data import paper
from needlehoop.study.render.table import p_value, percent, written
from needlehoop.study.stats.statistics import Estimated, Interval

_LEAST_TAU, _DRAWS = 0.5, 10_000


def beside_table(learnt: pd.DataFrame, imitated: pd.DataFrame) -> pd.DataFrame:
    """Each camera set's runs by PPO, the best first, beside its mean by imitation.

    ``learnt`` also says what each run threads by friction alone.
    """
    groups, by_imitation = learnt.groupby("cameras"), means(imitated)
    return pd.DataFrame(
        {
            "cameras": name,
            "PPO: threaded by seed, %": percent(groups.get_group(name)["success"].tolist()),
            "PPO: sampled, %": percent(float(np.mean(groups.get_group(name)["sampled"]))),
            "PPO: by friction, %": percent(groups.get_group(name)["friction"].tolist()),
            "imitation: threaded, mean, %": percent(by_imitation[name]),
        }
        for name in means(learnt)
    )


def stand_in_table(learnt: pd.DataFrame, imitated: pd.DataFrame) -> pd.DataFrame:
    """How the order of the paper's 14 sets by PPO agrees with that by imitation.

    ``learnt`` and ``imitated`` have a row for each run. The interval is a bootstrap's over the runs
    of each set, the p exact. There is neither interval nor verdict while a set has a single run.
    """
    sets = [*paper.measured()]
    tables = [runs.loc[runs["cameras"].isin(sets)] for runs in (learnt, imitated)]
    by_ppo, by_imitation = (means(runs) for runs in tables)
    tau = mean_tau([by_imitation], by_ppo)
    within, p = within_classes(by_ppo, by_imitation)
    if min(runs["cameras"].value_counts().min() for runs in tables) < 2:
        interval, verdict = None, "too few seeds"
    else:
        drawn = _drawn_taus(*tables)
        low, high = (float(np.nanquantile(drawn, share)) for share in (0.025, 0.975))
        agrees = tau >= _LEAST_TAU and low > 0
        interval = Interval(low, high)
        verdict = "yes" if agrees and p < 0.05 else "only as a rule" if agrees else "no"
    rows = (
        ("all 14", written(Estimated(tau, interval)), "", verdict),
        ("within the rule's two classes", written(within), p_value(p), ""),
    )
    return pd.DataFrame(rows, columns=("camera sets", "τ-b (95 %)", "exact p", "a stand-in"))


def _drawn_taus(*tables: pd.DataFrame) -> np.ndarray:
    """tau-b of draws of as many runs of each set, for both ways of training."""
    generator = np.random.default_rng(0)
    sides = []
    for runs in tables:
        groups = [group["success"].to_numpy() for _, group in runs.groupby("cameras")]
        columns = [generator.choice(group, (_DRAWS, len(group))).mean(1) for group in groups]
        # Rounded, so that equal means are ties.
        sides.append(_signs(np.stack(columns, -1).round(9)))
    first, second = sides
    with np.errstate(invalid="ignore"):
        return (first * second).sum(-1) / np.sqrt((first**2).sum(-1) * (second**2).sum(-1))


def within_classes(first: Scores, second: Scores) -> tuple[float, float]:
    """tau-b over the pairs of sets of one class of the rule, and its exact one-sided p.

    The p is the share of the orders of ``second`` within the classes that agree as well.
    """
    observed, sizes, counts = 0, np.zeros(2), Counter({0: 1})
    for is_of in (True, False):
        names = [name for name in sorted(first) if is_two_sided(name) is is_of]
        # Ranks of one byte: there are 362,880 orders of nine.
        a, b = (
            np.unique([side[name] for name in names], return_inverse=True)[1].astype(np.int8)
            for side in (first, second)
        )
        signs = _signs(a), _signs(b)
        observed += int((signs[0] * signs[1]).sum())
        sizes += [int(np.abs(one).sum()) for one in signs]
        orders = np.array([*permutations(b.tolist())], np.int8)
        ways = Counter((_signs(orders) * signs[0]).sum(-1).tolist())
        sums: Counter[int] = Counter()
        for (before, times), (value, way) in product(counts.items(), ways.items()):
            sums[before + value] += times * way
        counts = sums
    as_well = sum(times for value, times in counts.items() if value >= observed)
    return observed / float(np.sqrt(sizes.prod())), as_well / sum(counts.values())


def _signs(values: np.ndarray) -> np.ndarray:
    """Signs of the differences ``(…, pairs)`` of all pairs of values ``(…, n)``."""
    one, other = np.triu_indices(values.shape[-1], 1)
    return np.sign(values[..., one] - values[..., other])
