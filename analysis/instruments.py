"""Q7 of docs/protocol.md: cameras on instruments and in an endoscope."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from analysis.dots import trainings_figure
from analysis.protocol import mean_tau, means, more, regret
from needlehoop.study.render.table import percent, written
from needlehoop.study.stats.statistics import Estimated, share

RENDERINGS = {"rgb": "colour", "seg": "segmentation", "dep": "colour and depth"}
VIEWS = {
    "wrist": "instrument alone",
    "front+wrist": "front + instrument",
    "ecm_left+wrist": "one eye + instrument",
    "front+side": "front + side",
    "ecm_left+ecm_right": "endoscope, two eyes",
    "ecm_left": "endoscope, one eye",
}
"""Q7's sets of views, and what the page calls them."""

MARGIN = 0.05
"""Success that a set may lose and still be enough."""


def views_of(cameras: str) -> str:
    """The views of a camera set, such as ``ecm_left+wrist``."""
    return "+".join(camera.partition("_")[2] for camera in cameras.split("+"))


def rendering_of(cameras: str) -> str:
    """The one rendering of a camera set's cameras."""
    return cameras.partition("_")[0]


def _successes(runs: pd.DataFrame, views: str, rendering: str) -> list[float]:
    cameras = runs["cameras"]
    chosen = (cameras.map(views_of) == views) & (cameras.map(rendering_of) == rendering)
    return runs.loc[chosen].sort_values("seed")["success"].tolist()


def views_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Q7's sets of views, the best first: mean success in each rendering, and of all."""
    rows = []
    for views, label in VIEWS.items():
        successes = {name: _successes(runs, views, name) for name in RENDERINGS}
        mean = float(np.mean([np.mean(values) for values in successes.values()]))
        row = {"views": f"{label} (`{views}`)"}
        for name, values in successes.items():
            row[f"{RENDERINGS[name]}: threaded (95 %), %"] = percent(share(values))
        rows.append((mean, row | {"mean, %": percent(mean)}))
    return pd.DataFrame([row for _, row in sorted(rows, key=lambda pair: -pair[0])])


def questions_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Q7's questions: what a set of views gains over another, and the protocol's verdict."""
    rows = []
    for question, views, other, is_pooled in (
        ("one camera on the instrument is enough", "wrist", "front+side", False),
        ("the endoscope is enough", "ecm_left+ecm_right", "front+side", False),
        ("the instrument's camera adds something", "ecm_left+wrist", "ecm_left", True),
    ):
        ours, theirs = (
            {name: _successes(runs, chosen, name) for name in RENDERINGS}
            for chosen in (views, other)
        )
        gains = {name: more(ours[name], theirs[name]) for name in RENDERINGS}
        row = {"question": f"{question} (`{views}` less `{other}`)"}
        row |= {f"{RENDERINGS[name]}, points (95 %)": _points(gain) for name, gain in gains.items()}
        if is_pooled:
            gain = more(_centred(ours, theirs), _centred(theirs, theirs))
            points, verdict = _points(gain), _verdict(_is_above(0.0, gain), gain)
        else:
            enough = sum(_is_above(-MARGIN, gain) for gain in gains.values())
            points, verdict = "", _verdict(enough >= 2, *gains.values())
        rows.append(row | {"all, points (95 %)": points, "verdict": verdict})
    return pd.DataFrame(rows)


def _is_above(least: float, gain: Estimated) -> bool:
    return gain.interval is not None and gain.interval.low > least


def _verdict(is_so: bool, *gains: Estimated) -> str:
    if any(gain.interval is None for gain in gains):
        return "too few seeds"
    return "yes" if is_so else "no"


def _centred(
    values: Mapping[str, Sequence[float]], around: Mapping[str, Sequence[float]]
) -> list[float]:
    """All runs, less the mean that ``around`` has in their rendering."""
    return [run - float(np.mean(around[name])) for name, runs in values.items() for run in runs]


def _points(gain: Estimated) -> str:
    return written(gain, "+.0f", 100.0)


def model_scores(recording: Path) -> dict[str, dict[str, float]]:
    """Minus a model's mean place of each camera set over its answers, by rendering."""
    ranked = pd.read_csv(recording / "rankings_sets.csv")
    places = means(ranked, of="place")
    return _by_rendering({name: -place for name, place in places.items()})


def probe_scores(folder: Path) -> dict[str, dict[str, float]]:
    """The probe's score of each camera set, by rendering; ``folder`` has a table for each."""
    tables = [pd.read_csv(folder / f"probe_{name}.csv") for name in RENDERINGS]
    return _by_rendering(means(pd.concat(tables), of="score"))


def _by_rendering(scores: Mapping[str, float]) -> dict[str, dict[str, float]]:
    return {
        name: {cams: score for cams, score in scores.items() if rendering_of(cams) == name}
        for name in RENDERINGS
    }


def predictions_table(
    predictions: Mapping[str, Mapping[str, Mapping[str, float]]], runs: pd.DataFrame
) -> pd.DataFrame:
    """How well each prediction of the six sets agrees with success: τ-b, and what it loses."""
    measured = means(runs)
    rows = []
    for source, lists in predictions.items():
        row = {"prediction": source}
        for name, scores in lists.items():
            row[f"τ-b, {RENDERINGS[name]}"] = written(mean_tau([scores], measured))
        every = [*lists.values()]
        row["τ-b, mean"] = written(mean_tau(every, measured))
        lost = regret(every, measured)
        rows.append(row | {"its first loses, points": written(lost, ".0f", 100)})
    return pd.DataFrame(rows)


def views_figure(runs: pd.DataFrame) -> Figure:
    """A row for each set of views, a dot for each training, a colour for each rendering."""
    rows = {
        label: {kind: _successes(runs, views, name) for name, kind in RENDERINGS.items()}
        for views, label in VIEWS.items()
    }
    mean = {label: np.mean([np.mean(runs) for runs in row.values()]) for label, row in rows.items()}
    ordered = {label: rows[label] for label in sorted(rows, key=mean.__getitem__)}
    return trainings_figure(ordered, [*RENDERINGS.values()], 8.0)
