"""Luck, the paper's comparisons and rewards, held against values worked out in other ways."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import ttest_rel
from study_files import BUFFER, PAIRS, REWARDED, write_run, write_study

from analysis.comparisons import CLAIMS, claims, difference, writers
from needlehoop.study.render.table import Estimated
from needlehoop.study.stats.findings import paper_findings, study_findings
from needlehoop.study.stats.run import (
    CHEAT,
    HUMAN_POINTS,
    RETURN,
    SUCCESS,
    SUCCESS_OVER_TRAINING,
    TRAINING,
)

NAMES = ("dep_front+seg_side", "dep_front+dep_side", "rgb_front+rgb_side", "dep_default")
SHORT = {"updates": 3, "steps": 3 * BUFFER}

SETS = ("dep_front+seg_side", "dep_front+rgb_side", "rgb_front+seg_side")


def rewrite(run, **numbers):
    path = run / "evaluation.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | numbers))


def ends_of(found: Estimated | None) -> tuple[float, float]:
    assert found is not None
    assert found.interval is not None
    return found.interval.low, found.interval.high


def test_the_papers_own_numbers_bear_its_claims_out():
    for claim in CLAIMS:
        better, worse = claim.published
        assert better > worse
        assert not set(claim.better) & set(claim.worse)


def test_a_study_like_the_paper_bears_them_out_too(tmp_path):
    found = claims(study_findings(write_study(tmp_path / "main", PAIRS, seeds=3)), RETURN)
    assert [*found] == [*CLAIMS]
    # Made-up returns scatter by 0.3 around the paper's, and some of its own differ by less.
    clear = [one for one in found.values() if abs(one.value) > 1.0]
    assert len(clear) > 6
    assert all(ends_of(one)[0] > 0 for one in clear)
    assert claims(paper_findings(tmp_path), RETURN) == {}


def test_a_claim_is_judged_by_its_interval(tmp_path):
    for number, (front, side, low, high) in enumerate(
        (
            ([8.0, 8.2, 8.1], [5.0, 5.5, 5.2], True, True),
            ([5.0, 5.5, 5.2], [8.0, 8.2, 8.1], False, False),
            ([5.0, 8.5, 7.0], [8.0, 5.2, 7.1], False, True),
            ([8.0, 8.1], [5.0, 5.2], True, True),
            ([5.0], [8.0, 8.1, 8.2], None, None),
        )
    ):
        study = tmp_path / str(number)
        for cameras, values in (("dep_front+rgb_side", front), ("rgb_front+dep_side", side)):
            for seed, value in enumerate(values):
                rewrite(
                    write_run(study, cameras, seed=seed, updates=2, steps=20_480),
                    **{"return": value},
                )
        # Others' sets have not been trained.
        ((claim, found),) = claims(study_findings(study), RETURN).items()
        assert claim.text == "depth is better in front than at the side"
        assert found.value == pytest.approx(np.mean(front) - np.mean(side))
        if low is None:
            assert found.interval is None
            continue
        assert tuple(end > 0 for end in ends_of(found)) == (low, high)
        # Student's, of the two sets' pooled scatter.
        free = len(front) + len(side) - 2
        squares = sum(float(np.var(own)) * len(own) for own in (front, side))
        error = np.sqrt(squares / free * (1 / len(front) + 1 / len(side)))
        quantile = {4: 2.7764, 2: 4.3027}[free]
        assert ends_of(found)[1] == pytest.approx(found.value + quantile * error, abs=1e-3)


def threaded(run) -> float:
    """The mean success of all training episodes, by buffers."""
    with (run / "metrics.csv").open(newline="") as file:
        known = [float(row["success"]) for row in csv.DictReader(file) if row["success"]]
    return sum(known) / len(known)


def test_differences_are_paired_by_cameras(tmp_path):
    points = {"human": [8.8, 8.7, 8.1], "vlm_text": [8.5, 6.0, 7.9]}
    soon: dict[str, list[float]] = {}
    for reward, own in points.items():
        for number, (cameras, value) in enumerate(zip(SETS, own, strict=True)):
            goal = value - (reward == "vlm_text")
            # Not called vlm_text while it is made: runs of that name never thread there.
            run = write_run(tmp_path / reward, cameras, goal=goal, noise=number)
            rewrite(run, return_human=value, success=value / 10, cheat=0.25)
            soon.setdefault(reward, []).append(threaded(run))
            to = tmp_path / "main" / cameras / reward
            to.parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / reward / cameras / "human").rename(to)
    ((name, pairs),) = writers(study_findings(tmp_path / "main")).items()
    assert (name, len(pairs)) == ("VLM, text, against human", 3)
    for measure, values in (
        (HUMAN_POINTS, points),
        (SUCCESS, {reward: np.array(own) / 10 for reward, own in points.items()}),
        (SUCCESS_OVER_TRAINING, soon),
    ):
        test = ttest_rel(values["vlm_text"], values["human"]).confidence_interval(0.95)
        assert ends_of(difference(pairs, measure)) == pytest.approx((test.low, test.high))
    assert ends_of(difference(pairs, CHEAT)) == (0.0, 0.0)


def test_an_image_is_judged_by_all_who_wrote_with_and_without(tmp_path):
    points = {
        "vlm_text": [3.0, 4.0],
        "vlm_img": [5.0, 7.0],
        "vlm_text_claude": [8.0],
        "vlm_img_claude": [7.0],
    }
    for reward, own in points.items():
        for cameras, value in zip(SETS, own, strict=False):
            rewrite(write_run(tmp_path / "main", cameras, reward), return_human=value)
    found = writers(study_findings(tmp_path / "main"))
    told = {name: difference(pairs, HUMAN_POINTS) for name, pairs in found.items()}
    assert {name: (one and one.value, len(found[name])) for name, one in told.items()} == {
        "VLM, text + image, against text alone": (2.5, 2),
        "claude, text + image, against text alone": (-1.0, 1),
        "an image, whoever writes": (pytest.approx(4 / 3), 3),
    }
    # Two pairs are too few for an interval.
    few = told["VLM, text + image, against text alone"]
    assert few is not None
    assert few.interval is None


def test_what_a_run_does_not_say_is_not_compared(tmp_path):
    study = tmp_path / "main"
    rewrite(write_run(study, SETS[0]), return_human=8.0)
    # A seed more is a middle, not a pair more.
    for seed, value in enumerate((4.0, 6.0)):
        rewrite(write_run(study, SETS[0], "vlm_text", seed), return_human=value)
    (pairs,) = writers(study_findings(study)).values()
    assert difference(pairs, HUMAN_POINTS) == Estimated(-3.0)
    write_run(study, SETS[0], "vlm_text", 2, updates=60)
    (pairs,) = writers(study_findings(study)).values()
    # Its evaluations have no human points, and its training is not over.
    assert difference(pairs, HUMAN_POINTS) is None
    assert difference(pairs, TRAINING) is None
    assert difference(pairs, SUCCESS) is not None
    for number, pairs in enumerate(
        (PAIRS[:2], REWARDED[:1], [("rgb_default", "sparse"), PAIRS[0]])
    ):
        alone = write_study(tmp_path / str(number), pairs, seeds=1)
        assert writers(study_findings(alone)) == {}


def study_of(folder, groups, names=NAMES, column="return"):
    """A study of sets with these returns, in the end or in training; a tenth of it in success."""
    for name, values in zip(names, groups, strict=False):
        for seed, value in enumerate(values):
            run = write_run(folder, name, seed=seed, **SHORT)
            if column == "training":
                over_training(run / "metrics.csv", float(value))
                continue
            path = run / "evaluation.json"
            outcome = {"return": float(value), "success": float(value) / 10}
            path.write_text(json.dumps(json.loads(path.read_text()) | outcome))
    return study_findings(folder)


def over_training(path, mean):
    """Write returns with this mean into a run's metrics, whose first buffer ends no episode."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["return"] == ""
    for row, away in zip(rows[1:], (-0.5, 0.5), strict=True):
        row["return"] = str(mean + away)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def test_returns_over_training_are_those_of_all_buffers(tmp_path):
    groups = [[4.0, 4.5], [2.0, 2.25]]
    found = study_of(tmp_path / "main", groups, column="training")
    values = found.by_set(TRAINING)
    assert [values[name] for name in NAMES[:2]] == groups
    for number in range(len(groups)):
        write_run(tmp_path / "short", NAMES[number], updates=20)
    assert study_findings(tmp_path / "short").by_set(TRAINING) == {}
