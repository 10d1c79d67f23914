"""What the runs of docs/protocol.md say of Q1 (which cameras?) and Q2 (could it be predicted?).

They may be of any task with the paper's camera sets: Q5 asks whether it holds on another task.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, permutations, product

import numpy as np
import pandas as pd
import statsmodels.formula.api as smf
from matplotlib.figure import Figure
from scipy.stats import PermutationMethod, kendalltau, mannwhitneyu
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from analysis.dots import trainings_figure
from analysis.runs import is_two_sided
from needlehoop.study.data import paper
from needlehoop.study.render.style import COLOURS, FAINT, new_figure
from needlehoop.study.render.table import p_value, percent, written
from needlehoop.study.stats.agreement import agreement
from needlehoop.study.stats.predictions import Prediction
from needlehoop.study.stats.statistics import (
    ENOUGH,
    Estimated,
    Interval,
    share,
)

TRAITS = {
    "two_views": "a front and a side view",
    "depth": "depth, without segmentation",
    "labels": "segmentation, without depth",
    "depth:labels": "both, beyond the sum of the two",
}
"""Terms of the linear model, and what the page calls them."""

COLOUR = ("rgb_default", "rgb_front+rgb_side")
"""Camera sets of colour alone."""

PREREGISTERED = ("the paper's VLM", "claude", "probe")

CHANCE, EXACT = "chance to beat it", "exact p"

RULE, RANDOM = "the rule", "picked at random"

Scores = Mapping[str, float]


def means(rows: pd.DataFrame, of: str = "success", by: str = "cameras") -> dict[str, float]:
    """Mean of a column by camera set, or by another column, the best first."""
    # Rounded, so that equal means are ties.
    found = {str(name): round(float(np.mean(group[of])), 9) for name, group in rows.groupby(by)}
    return dict(sorted(found.items(), key=lambda pair: (-pair[1], pair[0])))


def more(first: Sequence[float], second: Sequence[float]) -> Estimated:
    """Mean of the first runs less that of the second, with Welch's 95 % interval."""
    value = float(np.mean(first) - np.mean(second))
    if min(len(first), len(second)) < ENOUGH:
        return Estimated(value)
    both = CompareMeans(DescrStatsW(first), DescrStatsW(second))
    low, high = both.tconfint_diff(usevar="unequal")
    return Estimated(value, Interval(float(low), float(high)))


def beating(first: Sequence[float], second: Sequence[float]) -> dict[str, str]:
    """The chance that a run of the first beats one of the second; a tie is half. With an exact p.

    The test is two-sided: it takes every way to share all runs out between the two.
    """
    every_way = PermutationMethod(n_resamples=10**6)
    apart = mannwhitneyu(first, second, method=every_way)  # pyright: ignore[reportArgumentType]
    chance = float(apart.statistic) / (len(first) * len(second))
    return {CHANCE: written(chance), EXACT: p_value(float(apart.pvalue))}


def sets_table(runs: pd.DataFrame, done: str = "threaded") -> pd.DataFrame:
    """Each camera set's runs, their mean, and the chance that one of the best set beats one."""
    groups = {str(name): group for name, group in runs.groupby("cameras")}
    order = [*means(runs)]
    best = groups[order[0]]["success"].tolist()
    rows = []
    for name in order:
        successes = groups[name]["success"].tolist()
        against = {} if name == order[0] else beating(best, successes)
        rows.append(
            {
                "cameras": name,
                f"{done} by seed, %": percent(successes),
                "mean (95 %), %": percent(share(successes)),
                "sampled, %": percent(float(np.mean(groups[name]["sampled"]))),
                f"the best set's {CHANCE}": against.get(CHANCE, ""),
                EXACT: against.get(EXACT, ""),
            }
        )
    return pd.DataFrame(rows)


def best_table(runs: pd.DataFrame) -> pd.DataFrame:
    """What the set that does best in the other seeds does in a seed that did not choose it."""
    rows, successes = [], []
    for seed, left_out in runs.groupby("seed"):
        chosen = next(iter(means(runs.query("seed != @seed"))))
        successes.append(left_out.loc[left_out["cameras"] == chosen, "success"].item())
        rows.append((str(seed), chosen, percent(successes[-1])))
    rows.append(("mean", "", percent(float(np.mean(successes)))))
    names = ("seed left out", "best in the other seeds", "threaded in the seed left out, %")
    return pd.DataFrame(rows, columns=names)


def traits_table(runs: pd.DataFrame) -> pd.DataFrame:
    """What traits add to success over the paper's 14 sets: OLS on their means, HC3 errors."""
    ours = runs[runs["cameras"].isin(paper.measured())]
    sets = ours.groupby("cameras").mean(numeric_only=True).astype(float)
    table = {"what is added": [*TRAITS.values()]}
    for outcome, label in (("success", "success"), ("sampled", "success of the sampled policy")):
        fit = smf.ols(f"{outcome} ~ {' + '.join(TRAITS)}", sets).fit(cov_type="HC3", use_t=True)
        terms = fit.conf_int().assign(value=fit.params).loc[[*TRAITS]].to_numpy()
        table[f"{label}, points (95 %)"] = [
            written(Estimated(value, Interval(low, high)), "+.0f", 100.0)
            for low, high, value in terms
        ]
    return pd.DataFrame(table)


def changes_table(runs: pd.DataFrame) -> pd.DataFrame:
    """What other renderings do in the views of a set of colour alone, and whether they differ."""
    successes = {str(name): group["success"].tolist() for name, group in runs.groupby("cameras")}
    mean = {name: value for name, value in means(runs).items() if name in paper.measured()}
    rows = [
        {
            "colour alone": colour,
            "instead": name,
            "adds, points": written(mean[name] - mean[colour], "+.0f", 100.0),
            **beating(successes[name], successes[colour]),
        }
        for colour in COLOUR
        for name in mean
        if name != colour and is_two_sided(name) is is_two_sided(colour)
    ]
    return pd.DataFrame(rows)


def mean_tau(lists: Sequence[Scores], measured: Scores) -> float:
    """Mean tau-b over lists of scores with what was measured."""
    taus = [
        kendalltau([*scores.values()], [measured[name] for name in scores]).statistic
        for scores in lists
    ]
    return sum(taus) / len(taus)


def p_within_classes(lists: Sequence[Scores], measured: Scores) -> float:
    """p of a prediction's mean tau-b among all orders of its scores within the rule's two classes.

    So it asks what the prediction knows that "a front and a side view first" does not. The test is
    exact: it takes every order of every list with each of every other.
    """
    observed = mean_tau(lists, measured)
    taus = [[mean_tau([order], measured) for order in _within_classes(scores)] for scores in lists]
    every = [sum(pick) / len(pick) for pick in product(*taus)]
    return sum(tau >= observed - 1e-9 for tau in every) / len(every)


def _within_classes(scores: Scores) -> Iterator[dict[str, float]]:
    """All orders of a list's scores that leave each to a camera set of its class."""
    classes = [[name for name in scores if is_two_sided(name) is of] for of in (True, False)]
    orders = [permutations([scores[name] for name in names]) for names in classes]
    for values in product(*orders):
        yield dict(zip(chain(*classes), chain(*values), strict=True))


def regret(lists: Sequence[Scores], measured: Scores) -> float:
    """Success that choosing a list's first loses, mean over lists and over ties for first."""
    return float(np.mean([agreement((scores, measured)).regret for scores in lists]))


def predicted(predictions: Sequence[Prediction]) -> dict[str, list[Scores]]:
    """Scores by who predicts, list by list; of the rule and of no knowledge at all, too."""
    lists = [*paper.lists().values()]
    by_source: dict[str, list[Scores]] = {
        prediction.source: scores
        for prediction in predictions
        if all(scores := [prediction.lists.get(frozenset(names), {}) for names in lists])
    }
    by_source[RULE] = [{name: float(is_two_sided(name)) for name in names} for names in lists]
    by_source[RANDOM] = [dict.fromkeys(names, 0.0) for names in lists]
    return by_source


def held(
    source: str, lists: Sequence[Scores], measured: Scores
) -> tuple[float | None, float | None, float]:
    """Mean tau-b, p within classes and regret; ``None`` where there is nothing to test."""
    tau = None if source == RANDOM else mean_tau(lists, measured)
    p = None if source in (RULE, RANDOM) else p_within_classes(lists, measured)
    return tau, p, regret(lists, measured)


def predictions_table(predictions: Sequence[Prediction], measured: Scores) -> pd.DataFrame:
    """Each prediction of the paper's three lists beside the rule and a random choice."""
    rows = []
    for source, lists in predicted(predictions).items():
        tau, p, lost = held(source, lists, measured)
        kind = "preregistered" if source in PREREGISTERED else "exploratory"
        rows.append(
            {
                "prediction": source,
                "τ-b": written(tau),
                "p within classes": p_value(p),
                "regret, points": written(lost, ".1f", 100.0),
                "test": "" if source in (RULE, RANDOM) else kind,
            }
        )
    return pd.DataFrame(rows)


def sets_figure(runs: pd.DataFrame) -> Figure:
    """A row of dots for each camera set, one a run, the best set on top."""
    kinds = ("front and side view", "one view")
    rows = {}
    for name in reversed(means(runs)):
        successes = runs.loc[runs["cameras"] == name, "success"].tolist()
        rows[name] = {kinds[0 if is_two_sided(name) else 1]: successes}
    return trainings_figure(rows, kinds, 4.6)


def predictions_figure(predictions: Sequence[Prediction], measured: Scores) -> Figure:
    """How well each preregistered prediction agrees with success, beside the line of the rule."""
    lists = predicted(predictions)
    shown = (*PREREGISTERED, RULE)
    taus = [mean_tau(lists[source], measured) for source in shown]
    losses = [100 * regret(lists[source], measured) for source in shown]
    figure, ((left, right),) = new_figure(38, 1, 2, sharey=True)
    for axes, (*values, rule) in ((left, taus), (right, losses)):
        axes.plot(values, range(len(values)), "o", markersize=4, color=COLOURS[1], clip_on=False)
        axes.axvline(rule, color=FAINT, linestyle="--", linewidth=1, label="the rule")
        axes.grid(axis="x", color=FAINT, alpha=0.25, linewidth=0.5)
    left.set_yticks(range(len(PREREGISTERED)), PREREGISTERED)
    left.set_ylim(-0.5, len(PREREGISTERED) - 0.5)
    left.set_xlim(0, 1)
    left.set_xlabel("agreement with\ntraining, τ-b")
    right.set_xlim(left=0)
    right.set_xlabel("success that its\nchoice loses, points")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper right", frameon=False)
    return figure
