"""The paper's claims in one table: our evidence for each, and what we make of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd

from analysis.comparisons import CLAIMS, claims
from analysis.protocol import means, more
from analysis.runs import is_two_sided
from needlehoop.study.data import paper
from needlehoop.study.render.table import written
from needlehoop.study.stats.findings import StudyFindings
from needlehoop.study.stats.run import CHEAT, RETURN, SUCCESS

HOLDS, FAILS, OPEN = "holds", "does not hold", "cannot be said"
"""Verdicts."""

_BEST = "dep_front+seg_side"

_WELL = 80.0
"""Of 100 episodes: from there on a set trains well."""


def verdicts_table(
    imitated: pd.DataFrame,
    mounted: pd.DataFrame,
    written_rewards: pd.DataFrame,
    study: Callable[[str], StudyFindings],
) -> pd.DataFrame:
    """A row for each claim.

    Args:
        imitated: runs of the protocol's first question.
        mounted: those with cameras on instruments.
        written_rewards: those of the question who should write the reward.
        study: by its name, what the paper's own protocol gave.
    """
    return pd.DataFrame([
        _extremes(means(imitated)),
        _singles(study("fast"), study("table2"), mounted),
        _renderings(study("fast"), study("table2")),
        _best(means(imitated), study("table2")),
        _writers(written_rewards),
        _cheats(study("rewards"), written_rewards),
        _one_camera(means(imitated), mounted),
    ])  # fmt: skip


def _row(says: str, where: str, found: str, verdict: str, link: str) -> dict[str, str]:
    names = ("the paper says", "where", "what we found", "verdict", "more")
    return dict(zip(names, (says, where, found, verdict, link), strict=True))


def _successes(found: StudyFindings) -> dict[str, float]:
    return {name: 100 * float(np.mean(own)) for name, own in found.by_set(SUCCESS).items()}


def _range(values: Iterable[float]) -> str:
    own = [*values]
    low, high = min(own), max(own)
    return f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"


def _extremes(success: dict[str, float]) -> dict[str, str]:
    first = worst = 0
    said = [one.places for one in paper.answers().rankings]
    for places in said:
        ranked = sorted(places, key=success.__getitem__)
        order = sorted(places, key=places.__getitem__)
        first += order[0] == ranked[-1]
        worst += order[-1] == ranked[0]
    n = len(said)
    told = f"by imitation, of {n} lists it names the best set in {first} and the worst in {worst}"
    verdict = HOLDS if first + worst == 2 * n else FAILS
    return _row(
        "A VLM finds the best and the worst set of each list",
        "V, VLM predictions",
        told,
        verdict,
        "[Q2](evidence.md#q2-could-it-have-been-predicted)",
    )


def _singles(fast: StudyFindings, long: StudyFindings, mounted: pd.DataFrame) -> dict[str, str]:
    alone = {name: one for name, one in _successes(long).items() if "+" not in name}
    sooner = {name: one for name, one in _successes(fast).items() if name in alone}
    best, wrist = max(sooner, key=sooner.__getitem__), 100 * means(mounted)["rgb_wrist"]
    verdict = FAILS if max(alone.values()) >= _WELL else HOLDS
    told = (
        f"single cameras thread in {_range(alone.values())} of 100 by PPO; `{best}` in"
        f" {sooner[best]:.0f} after a third of the steps; one on the instrument in"
        f" {wrist:.0f}, by imitation"
    )
    return _row(
        "No single camera trains well",
        "V, camera combinations",
        told,
        verdict,
        "[table](evidence.md#camera-sets)",
    )


def _renderings(fast: StudyFindings, long: StudyFindings) -> dict[str, str]:
    own = claims(fast, RETURN)
    depth, labels = (own[CLAIMS[i]] for i in (1, 4))
    lows = [one.interval.low if one.interval else -1.0 for one in (depth, labels)]
    verdict = HOLDS if min(lows) > 0 else OPEN
    pairs = {name: one for name, one in _successes(long).items() if is_two_sided(name)}
    told = (
        f"depth adds {written(depth, '+.1f')} points of return, segmentation"
        f" {written(labels, '+.1f')}, after 0.5 M steps; after 1.5 M every pair threads in"
        f" {_range(pairs.values())} of 100"
    )
    return _row(
        "Depth and segmentation lift pairs of colour",
        "V, camera combinations",
        told,
        verdict,
        "[ten comparisons](evidence.md#the-papers-ten-comparisons)",
    )


def _best(success: dict[str, float], long: StudyFindings) -> dict[str, str]:
    place = [*success].index(_BEST) + 1
    pairs = {name: one for name, one in _successes(long).items() if is_two_sided(name)}
    told = (
        f"it is {place}th of {len(success)} by imitation ({100 * success[_BEST]:.0f} of 100); after"
        f" 1.5 M steps of PPO {len(pairs)} pairs are at their ceiling ({_range(pairs.values())})"
    )
    return _row(
        "`dep_front+seg_side` is best",
        "V, camera combinations",
        told,
        HOLDS if place == 1 else FAILS,
        "[Q1](evidence.md#q1-which-cameras)",
    )


def _writers(runs: pd.DataFrame) -> dict[str, str]:
    mean = means(runs, by="reward")
    text, image, human = (100 * mean[name] for name in ("vlm_text", "vlm_img", paper.HUMAN))
    own = (runs[runs["reward"] == name]["success"].tolist() for name in ("vlm_img", "vlm_text"))
    ends = more(*own).interval
    verdict = HOLDS if ends and ends.low > 0 and image >= human else OPEN
    told = (
        f"`claude`'s rewards thread in {image:.0f} of 100 with an image and in {text:.0f} without,"
        f" the human one in {human:.0f}; five runs each, far apart"
    )
    return _row(
        "A reward written with an image beats one written from text, and reaches the human one",
        "V, VLM generated rewards",
        told,
        verdict,
        "[Q6](evidence.md#q6-who-should-write-the-reward)",
    )


def _cheats(study: StudyFindings, runs: pd.DataFrame) -> dict[str, str]:
    own = [100 * (one.middle(CHEAT) or 0.0) for one in study.results if one.reward == "vlm_text"]
    claude = 100 * means(runs, of="cheat", by="reward")["vlm_text"]
    told = (
        "under the paper's own text reward agents touch the goal without threading in"
        f" {_range(own)} of 100, under `claude`'s five in {claude:.0f}"
    )
    return _row(
        "Rewards written from text are cheated",
        "V, VLM generated rewards",
        told,
        "holds for the paper's reward",
        "[rewards](evidence.md#rewards)",
    )


def _one_camera(success: dict[str, float], mounted: pd.DataFrame) -> dict[str, str]:
    shaded = {name: 100 * one for name, one in success.items() if name.startswith("segdep_")}
    pairs = [100 * one for name, one in success.items() if is_two_sided(name)]
    wrist = 100 * means(mounted)["rgb_wrist"]
    told = (
        f"segmentation shaded by depth threads in {_range(shaded.values())} of 100 from one view,"
        f" pairs in {_range(pairs)}; colour from the instrument in {wrist:.0f}"
    )
    return _row(
        "Segmentation with depth may allow a single camera",
        "V, future work",
        told,
        "in part; where the camera is matters more",
        "[Q7](evidence.md#q7-cameras-on-instruments)",
    )
