"""Q3 of docs/protocol.md: where to put a camera. Rules and rankings against training."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import rankdata

from analysis.dots import of_hundred
from analysis.protocol import means
from needlehoop.envs.settings import compose_settings
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.scene.cameras import Orbit, View
from needlehoop.study.data.answers import read_answers
from needlehoop.study.render.style import COLOURS, INK, new_figure
from needlehoop.study.render.table import p_value, percent, written
from needlehoop.study.stats.statistics import Estimated, Interval

RULES = Path(__file__).parents[1] / "results" / "placements" / "rules.csv"
"""What the rules say of the 20 drawn cameras; written once, before the runs, at 04ee7d2."""
CAMERAS = [f"rgb_p{number:02d}" for number in range(1, 21)]

_DRAWS, _RESAMPLES = 10_000, 2_000

ELEVATION, PIXELS, HIDDEN = "elevation nearest 45°", "most pixels", "least hidden"
MODEL = "claude"
ALONE, APART, FRONT = "success of each alone", "angle nearest 90°", "nearest the front"


@cache
def _views() -> Mapping[str, View]:
    """The views of the experiment, the drawn cameras among them."""
    return compose_settings(["+experiment=placements", f"cams=[{CAMERAS[0]}]"]).views


def scores(cameras: int = 1) -> pd.DataFrame:
    """Scores of sets of so many cameras, by the rules and by the model that ranked them; higher is
    better. A rule's score of a pair is the mean of its cameras'."""
    answers = read_answers(RECORDINGS / "claude_placements", "rankings_sets.json")
    assert answers is not None
    single = pd.read_csv(RULES, index_col="camera")
    (places,) = (one.places for one in answers.rankings if _size(one.places) == cameras)
    table = pd.DataFrame({name: single.loc[name.split("+")].mean() for name in places}).T
    return table.assign(**{MODEL: -pd.Series(places)}).sort_index()


def _size(names: Iterable[str]) -> int:
    """Cameras of each of these sets."""
    (size,) = {name.count("+") + 1 for name in names}
    return size


def single_scores() -> pd.DataFrame:
    """Of single cameras; also how near the front they stand, a rule tried after the runs."""
    table = scores()
    return table.assign(**{FRONT: [-abs(_place_of(camera).azimuth) for camera in table.index]})


def pair_scores(singles: pd.DataFrame) -> pd.DataFrame:
    """Of pairs; also the success of their cameras alone, and the angle between their views."""
    table, measured = scores(2), means(singles)
    pairs = [name.split("+") for name in table.index]
    alone = [np.mean([measured[camera] for camera in pair]) for pair in pairs]
    return table.assign(**{ALONE: alone, APART: [-abs(_apart(pair) - 90.0) for pair in pairs]})


def _place_of(camera: str) -> Orbit:
    orbit = _views()[camera.partition("_")[2]].orbit
    assert orbit is not None
    return orbit


def _apart(pair: list[str]) -> float:
    """The angle between the directions from which two cameras look, degrees."""
    around, up = np.radians([(view.azimuth, view.elevation) for view in map(_place_of, pair)]).T
    toward = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    return float(np.degrees(np.arccos(toward[:, 0] @ toward[:, 1])))


def correlations(scores: pd.DataFrame, runs: pd.DataFrame) -> list[dict[str, str]]:
    """Of each prediction (a column of ``scores``): its name, Spearman's ρ with mean success by
    camera set, how often a shuffled order agrees as well, and regret."""
    measured = pd.Series(means(runs))
    truth = measured.to_numpy()
    draw = np.random.default_rng(0)
    rows = []
    for prediction in map(str, scores):
        predicted = scores.loc[measured.index, prediction].to_numpy(float)
        shuffled = draw.permuted(np.tile(predicted, (_DRAWS, 1)), axis=1)
        (rho,) = _rho(predicted[None], truth[None])
        chance = (1 + np.sum(_rho(shuffled, truth[None]) >= rho - 1e-9)) / (1 + _DRAWS)
        ends = Interval(*np.nanpercentile(_drawn(scores, prediction, runs), (2.5, 97.5)))
        lost = float(truth.max() - truth[predicted == predicted.max()].mean())
        rows.append(
            {
                "prediction": prediction,
                "ρ (95 %)": written(Estimated(float(rho), ends)),
                "p": p_value(float(chance)),
                "regret, points": percent(lost),
            }
        )
    return rows


def predictions_table(scores: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Each prediction of these camera sets beside a random choice; for the model, also the share of
    draws in which its ρ beats the best rule's."""
    success = pd.Series(means(runs))
    rules = (PIXELS, HIDDEN, ELEVATION)
    rho = scores.loc[success.index, [*rules]].corrwith(success, method="spearman")
    above = _drawn(scores, MODEL, runs) > _drawn(scores, str(rho.idxmax()), runs)
    blind = {"prediction": "picked at random",
             "regret, points": percent(float(success.max() - success.mean()))}  # fmt: skip
    rows = pd.DataFrame([*correlations(scores, runs), blind]).fillna("")
    share = percent(float(np.mean(above)))
    rows["above the best rule, %"] = [share if name == MODEL else "" for name in rows["prediction"]]
    return rows


def places_table(runs: pd.DataFrame) -> pd.DataFrame:
    """Place and success of each single camera or pair, the best first, and what was predicted."""
    cameras = _size(runs["cameras"])
    places = (-scores(cameras)).rank(method="min").astype(int)
    rows = []
    for name in means(runs):
        group, views = runs[runs["cameras"] == name], [_place_of(cam) for cam in name.split("+")]
        placed = {f"place by {source}": str(places.loc[name, source])
                for source in (MODEL, PIXELS, HIDDEN, ELEVATION)}  # fmt: skip
        rows.append(
            {
                "camera" if cameras == 1 else "cameras": name,
                "azimuth, °": written([view.azimuth for view in views], ".0f"),
                "elevation, °": written([view.elevation for view in views], ".0f"),
                "threaded by seed, %": percent(group["success"].tolist()),
                "sampled, %": percent(float(np.mean(group["sampled"]))),
                **placed,
            }
        )
    return pd.DataFrame(rows)


def _rho(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Spearman's ρ of rows ``(k, n)``: ``(k,)``; NaN where a row is all on one level."""
    a, b = (rankdata(rows, axis=1) - (rows.shape[1] + 1) / 2 for rows in (a, b))
    with np.errstate(invalid="ignore"):
        return (a * b).sum(1) / np.sqrt((a**2).sum(1) * (b**2).sum(1))


def _drawn(scores: pd.DataFrame, prediction: str, runs: pd.DataFrame) -> np.ndarray:
    """ρ of a prediction with cameras drawn anew, and the runs of each, ``(k,)``. All predictions
    have the same draws."""
    draw = np.random.default_rng(1)
    names = [*means(runs)]
    groups = [runs[runs["cameras"] == name]["success"].to_numpy() for name in names]
    drawn = np.stack([draw.choice(group, (_RESAMPLES, len(group))).mean(1) for group in groups], 1)
    picked = draw.integers(len(names), size=drawn.shape)
    predicted = scores.loc[names, prediction].to_numpy(float)
    return _rho(predicted[picked], np.take_along_axis(drawn, picked, 1))


def places_figure(singles: pd.DataFrame, pairs: pd.DataFrame) -> Figure:
    """A map of the hemisphere seen from above with what each place gave, and beside it what each
    pair gave and the better of its two cameras alone."""
    figure, ((flat, right),) = new_figure(72, 1, 2)
    axes: Any = figure.add_subplot(flat.get_subplotspec(), projection="polar")
    flat.remove()
    alone, both = means(singles), means(pairs)
    for name, success in alone.items():
        view = _place_of(name)
        angle, down = np.radians(view.azimuth), 90.0 - view.elevation
        dark = success / max(alone.values())
        axes.scatter([angle], [down], s=75, c=[dark], cmap="Blues", vmin=-0.4, vmax=1, linewidths=0)
        ink = "white" if dark > 0.45 else INK
        label = f"{100 * success:.0f}"
        axes.text(angle, down, label, ha="center", va="center", fontsize=5, color=ink)
    axes.set_title("one camera", loc="center", pad=10)
    axes.set_xlabel("threaded, of 100\n(from above, rings 30° apart)")
    # As in the scene: azimuth grows to the left of a viewer in front.
    axes.set_theta_zero_location("S")
    axes.set_theta_direction(-1)
    axes.set_rlim(0, 90)
    axes.set_rgrids([30, 60], [])
    axes.set_thetagrids([0, 45, 90, 180, 270], ["front", "side", "", "behind the arm", ""])
    axes.tick_params(labelsize=5.5, pad=-3)
    axes.grid(linewidth=0.4, alpha=0.5)
    order = [*both][::-1]
    better = [max(alone[camera] for camera in name.split("+")) for name in order]
    shown = (("both", [both[name] for name in order], 0), ("the better one alone", better, 1))
    for label, values, colour in shown:
        across = [100 * value for value in values]
        right.plot(across, range(len(order)), "o", markersize=3, color=COLOURS[colour], label=label)
    right.set_yticks([])
    right.set_ylabel("20 random pairs")
    of_hundred(right)
    right.set_title("two cameras", loc="center", pad=10)
    figure.legend(loc="outside lower right", ncols=2, frameon=False, fontsize=6)
    return figure
