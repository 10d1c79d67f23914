"""Q4 of docs/protocol.md: which camera sets survive disturbances, trained with and without."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from analysis.dots import of_hundred
from analysis.placements import correlations
from analysis.protocol import means
from analysis.runs import RUN
from needlehoop.runs.files import ALL, NONE
from needlehoop.study.render.style import COLOURS, FAINT, new_figure
from needlehoop.study.render.table import percent

MODERATE = "moderate"
"""What agents were trained under, beside none."""


def survival(stress: pd.DataFrame) -> pd.DataFrame:
    """A row for each tested run: success undisturbed, its mean over axes, and under all at once.

    ``stress`` has a row for each condition, all of one severity but for the undisturbed.
    """
    axes = stress.query("axis not in (@NONE, @ALL)")
    columns = {
        NONE: stress.query("axis == @NONE").set_index(RUN)["success"],
        "success": axes.groupby(RUN)["success"].mean(),
        ALL: stress.query("axis == @ALL").set_index(RUN)["success"],
    }
    return pd.DataFrame(columns).reset_index()


def sets_table(runs: pd.DataFrame, survived: pd.DataFrame) -> pd.DataFrame:
    """The camera sets, the best survivor first: trained undisturbed, and under ``moderate``."""
    plain = survived.query("disturb == @NONE")
    trained = survived.query("disturb == @MODERATE")
    columns = {
        "threaded in Q1": means(runs),
        "mean over axes": means(plain),
        "all axes at once": means(plain, ALL),
        "trained under moderate: undisturbed": means(trained, NONE),
        "trained under moderate: mean over axes": means(trained),
        "trained under moderate: all at once": means(trained, ALL),
    }
    rows = [
        {"cameras": name} | {f"{key}, %": percent(mean.get(name)) for key, mean in columns.items()}
        for name in means(plain)
    ]
    return pd.DataFrame(rows)


def axes_table(stress: pd.DataFrame) -> pd.DataFrame:
    """Mean success over camera sets by axis, the worst for agents trained undisturbed first."""
    plain, trained = (
        means(stress.query(f"disturb == '{option}'"), by="axis") for option in (NONE, MODERATE)
    )
    rows = [
        {
            "axis": axis,
            "trained undisturbed, %": percent(plain[axis]),
            "trained under moderate, %": percent(trained.get(axis)),
        }
        for axis in sorted(plain, key=plain.__getitem__)
    ]
    return pd.DataFrame(rows)


def predictions_table(runs: pd.DataFrame, stress: pd.DataFrame) -> pd.DataFrame:
    """Whether success without disturbances predicts that under them: Spearman's ρ over sets.

    The other seeds are those that were not tested: with them no run predicts itself. What costs
    most is shown by itself, too.
    """
    untested = runs.query("seed not in @stress.seed.tolist()")
    scores = pd.DataFrame({"Q1": means(runs), "Q1, other seeds": means(untested)})
    plain, trained = (stress.query(f"disturb == '{option}'") for option in (NONE, MODERATE))
    outcomes = {
        ("undisturbed", "mean over axes"): survival(plain),
        ("under moderate", "mean over axes"): survival(trained),
    }
    left = means(plain, by="axis")
    for axis in sorted(left, key=left.__getitem__)[:3]:
        outcomes["undisturbed", axis] = plain.query("axis == @axis")
    rows = [
        {"trained": training, "tested under": under} | row
        for (training, under), outcome in outcomes.items()
        for row in correlations(scores, outcome)
    ]
    return pd.DataFrame(rows)


def survival_figure(survived: pd.DataFrame) -> Figure:
    """A row for each camera set: undisturbed, and the mean over axes with either training."""
    plain, trained = (survived.query("disturb == @option") for option in (NONE, MODERATE))
    shown = {
        "undisturbed": means(plain, NONE),
        "disturbed": means(plain),
        "disturbed, trained like that": means(trained),
    }
    order = [*means(plain)][::-1]
    figure, ((axes,),) = new_figure(4.6 * len(order) + 22)
    styles = (("o", "none", FAINT), ("o", COLOURS[0], COLOURS[0]), ("D", COLOURS[1], COLOURS[1]))
    for (label, values), (mark, face, edge) in zip(shown.items(), styles, strict=True):
        across = [100 * values[name] for name in order]
        axes.plot(
            across, range(len(order)), mark, markersize=3.5, mfc=face, mec=edge, label=label,
            clip_on=False,
        )  # fmt: skip
    for row, name in enumerate(order):
        ends = [100 * shown[label][name] for label in ("undisturbed", "disturbed")]
        axes.plot(ends, [row, row], color=FAINT, linewidth=0.8, zorder=0)
    axes.set_yticks(range(len(order)), order)
    of_hundred(axes, "threaded, of 100\n(disturbed: mean of 27 kinds)")
    figure.legend(loc="outside upper right", ncols=3, frameon=False, fontsize=6)
    return figure
