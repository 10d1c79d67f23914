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
IT_DEPENDS = "depends on layout, length and luck"
"""Verdicts."""

_BEST = "dep_front+seg_side"

_WELL = 80.0
"""Of 100 episodes: from there on a set trains well."""

Finding = tuple[str, str]
"""What we found, and the verdict."""


def verdicts_table(
    imitated: pd.DataFrame,
    learnt: pd.DataFrame,
    mounted: pd.DataFrame,
    written_rewards: pd.DataFrame,
    study: Callable[[str], StudyFindings],
) -> pd.DataFrame:
    """A row for each claim.

    Args:
        imitated: runs of the protocol's first question, by imitation.
        learnt: those by PPO, also of seeds that not all sets have yet.
        mounted: those with cameras on instruments.
        written_rewards: those of the question who should write the reward.
        study: by its name, what the paper's own protocol gave.
    """
    success, by_ppo, fast, long = means(imitated), means(learnt), study("fast"), study("table2")
    wrist = 100 * means(mounted)["rgb_wrist"]
    rewards = study("rewards")
    rows = (
        ("A VLM finds the best and the worst set of each list", "V, VLM predictions",
         _extremes(success), "[Q2](evidence.md#q2-could-it-have-been-predicted)"),
        ("No single camera trains well", "V, camera combinations",
         _singles(success, learnt, long, wrist), "[table](evidence.md#camera-sets)"),
        ("Depth and segmentation lift pairs of colour", "V, camera combinations",
         _renderings(success, by_ppo, fast),
         "[ten comparisons](evidence.md#the-papers-ten-comparisons)"),
        (f"`{_BEST}` is best", "V, camera combinations",
         _best(success, learnt), "[Q1](evidence.md#q1-which-cameras)"),
        ("A reward written with an image beats one written from text, and reaches the human one",
         "V, VLM generated rewards",
         _writers(written_rewards), "[Q6](evidence.md#q6-who-should-write-the-reward)"),
        ("Rewards written from text are cheated", "V, VLM generated rewards",
         _cheats(rewards, written_rewards), "[rewards](evidence.md#rewards)"),
        ("Segmentation with depth may allow a single camera", "V, future work",
         _one_camera(success, wrist), "[Q7](evidence.md#q7-cameras-on-instruments)"),
    )  # fmt: skip
    names = ("the paper says", "where", "what we found", "verdict", "more")
    return pd.DataFrame(
        [(says, where, *finding, link) for says, where, finding, link in rows], columns=names
    )


def _successes(study: StudyFindings) -> dict[str, float]:
    return {name: 100 * float(np.mean(shares)) for name, shares in study.by_set(SUCCESS).items()}


def _pairs(success: dict[str, float]) -> str:
    """Of 100 episodes: success of the sets with a front and a side view."""
    return _range(100 * value for name, value in success.items() if is_two_sided(name))


def _range(values: Iterable[float]) -> str:
    numbers = [*values]
    low, high = min(numbers), max(numbers)
    return f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"


def _extremes(success: dict[str, float]) -> Finding:
    lists = [one.places for one in paper.answers().rankings]
    orders = [
        (sorted(one, key=one.__getitem__), sorted(one, key=success.__getitem__)) for one in lists
    ]
    first = sum(predicted[0] == measured[-1] for predicted, measured in orders)
    worst = sum(predicted[-1] == measured[0] for predicted, measured in orders)
    n = len(lists)
    return (
        f"by imitation, of {n} lists it names the best set in {first} and the worst in {worst}",
        HOLDS if first + worst == 2 * n else FAILS,
    )


def _singles(
    success: dict[str, float], learnt: pd.DataFrame, long: StudyFindings, wrist: float
) -> Finding:
    easier = {name: value for name, value in _successes(long).items() if "+" not in name}
    imitated = [100 * success[name] for name in easier]
    # By run: two runs of one set can lie 90 points apart.
    by_run = 100 * learnt.loc[learnt["cameras"].isin(easier), "success"]
    does_well = {max(values) >= _WELL for values in (imitated, by_run, easier.values())}
    return (
        f"wide layout: by imitation {_range(imitated)} of 100, one on the instrument {wrist:.0f};"
        f" single runs of 2 M steps of PPO {_range(by_run)}; by 1.5 M on the easier layout"
        f" {_range(easier.values())}",
        IT_DEPENDS if len(does_well) > 1 else FAILS if True in does_well else HOLDS,
    )


def _renderings(
    success: dict[str, float], by_ppo: dict[str, float], fast: StudyFindings
) -> Finding:
    differences = claims(fast, RETURN)
    imitated, learnt = (
        ", ".join(
            f"{100 * np.mean([way[name] for name in sets]):.0f}"
            for sets in (CLAIMS[1].worse, CLAIMS[1].better, CLAIMS[4].better)
        )
        for way in (success, by_ppo)
    )
    depth, labels = (differences[CLAIMS[i]] for i in (1, 4))
    lows = [gain.interval.low if gain.interval else -1.0 for gain in (depth, labels)]
    return (
        f"colour, with depth, with segmentation: by imitation {imitated} of 100; by 2 M steps of"
        f" PPO {learnt}; by 0.5 M on the easier layout depth adds {written(depth, '+.1f')} points"
        f" of return, segmentation {written(labels, '+.1f')}",
        HOLDS if min(lows) > 0 else OPEN,
    )


def _best(success: dict[str, float], learnt: pd.DataFrame) -> Finding:
    place = [*success].index(_BEST) + 1
    by_run = 100 * learnt.loc[learnt["cameras"].map(is_two_sided), "success"]
    return (
        f"it is {place}th of {len(success)} by imitation ({100 * success[_BEST]:.0f} of 100); by"
        " 2 M steps of PPO each run with a front and a side view is near the ceiling"
        f" ({_range(by_run)})",
        HOLDS if place == 1 else FAILS,
    )


def _writers(runs: pd.DataFrame) -> Finding:
    mean = means(runs, by="reward")
    text, image, human = (100 * mean[name] for name in ("vlm_text", "vlm_img", paper.HUMAN))
    pair = (runs[runs["reward"] == name]["success"].tolist() for name in ("vlm_img", "vlm_text"))
    ends = more(*pair).interval
    return (
        f"`claude`'s rewards thread in {image:.0f} of 100 with an image and in {text:.0f} without,"
        f" the human one in {human:.0f}; five runs each, far apart",
        HOLDS if ends and ends.low > 0 and image >= human else OPEN,
    )


def _cheats(study: StudyFindings, runs: pd.DataFrame) -> Finding:
    cheats = [100 * (one.middle(CHEAT) or 0.0) for one in study.results if one.reward == "vlm_text"]
    claude = 100 * means(runs, of="cheat", by="reward")["vlm_text"]
    return (
        "under the paper's own text reward agents touch the goal without threading in"
        f" {_range(cheats)} of 100, under `claude`'s five in {claude:.0f}",
        "holds for the paper's reward",
    )


def _one_camera(success: dict[str, float], wrist: float) -> Finding:
    shaded = [100 * value for name, value in success.items() if name.startswith("segdep_")]
    return (
        f"segmentation shaded by depth threads in {_range(shaded)} of 100 from one view,"
        f" pairs in {_pairs(success)}; colour from the instrument in {wrist:.0f}",
        "in part; where the camera is matters more",
    )
