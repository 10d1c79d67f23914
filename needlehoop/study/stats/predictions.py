"""Who predicted the best cameras: models, the probe, shorter trainings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data import paper
from needlehoop.study.data.answers import LESS, VLM, Answers, read_answers
from needlehoop.study.data.records import read_study
from needlehoop.study.stats.run import RETURN, final
from needlehoop.study.stats.statistics import iqm

MEASURED, PAPERS_MEASURED = "measured", "the paper's measured"
"""Orders that were measured; they stand beside the predicted ones."""

_PROBE, _FAST = "probe/ranking.csv", "fast"
"""Beside the studies: the probe, and the study of short trainings, which predicts the others."""


@dataclass(frozen=True)
class Prediction:
    """Scores (higher is better) of the camera sets in each list that was ranked."""

    source: str
    lists: Mapping[frozenset[str], Mapping[str, float]]
    sure: Mapping[frozenset[str], Sequence[tuple[str, str, float]]] = field(default_factory=dict)
    """Pairs of a list's sets: the better, the worse, and the probability that the model stated."""

    def brier(self, members: frozenset[str], measured: Mapping[str, float]) -> float | None:
        """Mean squared error of a list's stated probabilities; ``None`` where there are none.

        0 is perfect, and 0.25 is what 0.5 for every pair gets. Equal measurements count half.
        """
        errors = [
            (p - 0.5 - 0.5 * np.sign(measured[a] - measured[b])) ** 2
            for a, b, p in self.sure.get(members, ())
        ]
        return float(np.mean(errors)) if errors else None

    def places(self, members: Iterable[str]) -> dict[str, float]:
        """Places in a list by cameras, 1 the best, ties at their mean; empty if not ranked."""
        scores = self.lists.get(frozenset(members), {})
        return pd.Series(scores, dtype=float).rank(ascending=False).to_dict()


def recorded_answers() -> list[Answers]:
    """What the models of the shipped recordings said, each under its recording's name."""
    folders = sorted(file.parent for file in RECORDINGS.glob("*/rankings.json"))
    answers = {folder.name: read_answers(folder) for folder in folders}
    return [replace(answer, source=name) for name, answer in answers.items() if answer]


def predictions(
    answers: Answers | None, folder: Path, lists: Sequence[Iterable[str]], papers: bool
) -> list[Prediction]:
    """Every prediction of the study in ``folder``, in the order of the columns that show them.

    Args:
        answers: of the study's own model.
        lists: to cut scores of single sets into.
        papers: whether it has the paper's task and camera sets, which all others speak of.
    """
    rankings = [said(paper.SOURCE, paper.answers())] if papers else []
    for answers in recorded_answers() if papers else ():
        rankings += _said_by(answers.source, answers, RECORDINGS / answers.source)
    # A study that replays a recording says nothing that is not there already.
    by_model = _said_by("VLM", answers, folder / VLM)
    rankings += [new for new in by_model if all(new.lists != old.lists for old in rankings)]
    if papers and (path := folder.parent / _PROBE).exists():
        scores = pd.read_csv(path).set_index("cameras")["score"].to_dict()
        rankings.append(scored("probe", scores, lists))
    if papers and folder.name != _FAST and (path := folder.parent / _FAST).is_dir():
        rankings.append(scored("fast protocol", _returns(path), lists))
    return [ranking for ranking in rankings if ranking.lists]


def _said_by(source: str, answers: Answers | None, folder: Path) -> list[Prediction]:
    """A model's rankings, and those of the same model that were asked for in other ways."""
    replies = {source: answers}
    replies |= {f"{source}, {how}": read_answers(folder, name) for how, name in LESS.items()}
    return [said(name, reply) for name, reply in replies.items() if reply and reply.rankings]


def said(source: str, answers: Answers) -> Prediction:
    """A model's orders as a prediction."""
    orders = {frozenset(order.places): order for order in answers.rankings}
    scores = {
        members: {name: -place for name, place in order.places.items()}
        for members, order in orders.items()
    }
    return Prediction(source, scores, {members: order.sure for members, order in orders.items()})


def scored(
    source: str, scores: Mapping[str, float], lists: Iterable[Iterable[str]], whole: bool = True
) -> Prediction:
    """Scores of single sets, list by list; higher is better.

    Where one of a list's sets has no score, the list is left out, or if not ``whole`` the set.
    """
    known = set(scores)
    chosen = [m for m in map(frozenset, lists) if (m <= known if whole else m & known)]
    return Prediction(source, {m: {name: scores[name] for name in m & known} for m in chosen})


def _returns(folder: Path) -> dict[str, float]:
    """Returns of a study's finished runs by camera set."""
    ends: dict[str, list[float]] = {}
    for run in read_study(folder).runs:
        end = final(run)
        # Of a labelled run, other settings than its cameras may have decided.
        if end is not None and end.finished and run.config.get("label") is None:
            ends.setdefault(run.place.cameras, []).append(end.measures[RETURN])
    return {cameras: float(iqm(np.array(returns))) for cameras, returns in ends.items()}
