"""Who predicted the best cameras: models, the probe, shorter trainings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import FiniteFloat

from needlehoop.runs.reading import UnreadableError
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data import paper
from needlehoop.study.data.answers import LESS, VLM, Answers, read_answers
from needlehoop.study.data.contents import read_entries
from needlehoop.study.data.records import LeftOut, read_study
from needlehoop.study.stats.run import final
from needlehoop.study.stats.statistics import estimate

MEASURED, PAPERS_MEASURED = "measured", "the paper's measured"
"""Orders that were measured; they stand beside the predicted ones."""

_PROBE = Path("probe/ranking.csv")
"""Beside the studies."""

_FAST = "fast"
"""The study of short trainings, which predicts what others measure, beside them."""


@dataclass(frozen=True)
class _Probed:
    """A row of the probe's table."""

    cameras: str
    score: FiniteFloat


@dataclass(frozen=True)
class Prediction:
    """Scores (higher is better) of the camera sets in each list that was ranked."""

    who: str
    lists: Mapping[frozenset[str], Mapping[str, float]]
    sure: Mapping[frozenset[str], Sequence[tuple[str, str, float]]] = field(default_factory=dict)
    """Of pairs of a list's sets, the better one, the other, and the stated probability of that."""

    def brier(self, members: Iterable[str], measured: Mapping[str, float]) -> float | None:
        """Mean squared error of a list's stated probabilities; ``None`` where there are none.

        0 is perfect, and 0.25 is what 0.5 for every pair gets. Equal measurements count half.
        """
        pairs = self.sure.get(frozenset(members), ())
        errors = [
            (p - (0.5 + 0.5 * (measured[a] > measured[b]) - 0.5 * (measured[a] < measured[b]))) ** 2
            for a, b, p in pairs
        ]
        return sum(errors) / len(errors) if errors else None

    def places(self, members: Iterable[str]) -> dict[str, float]:
        """Places in a list by cameras, 1 the best, ties at their mean; empty if not ranked."""
        scores = self.lists.get(frozenset(members), {})
        return {
            name: 0.5
            + sum(o > own for o in scores.values())
            + sum(o == own for o in scores.values()) / 2
            for name, own in scores.items()
        }


def recorded_answers() -> tuple[Answers, ...]:
    """What the models of the shipped recordings said, each under its recording's name.

    Raises:
        ValueError: a recording is damaged.
    """
    found = []
    for folder in sorted(file.parent for file in RECORDINGS.glob("*/rankings.json")):
        answers, left_out = read_answers(folder, ".")
        if answers is None or left_out:
            raise ValueError(f"{folder}: {'; '.join(map(str, left_out))}")
        found.append(replace(answers, source=folder.name))
    return tuple(found)


def _said_by(
    who: str, answers: Answers | None, folder: Path, within: str, left_out: list[LeftOut]
) -> list[Prediction]:
    """A model's rankings, and those of the same model that were asked for in other ways."""
    found = [said(who, answers)] if answers and answers.rankings else []
    for how, name in LESS.items():
        other, unread = read_answers(folder, within, name)
        left_out += [one for one in unread if one.path.name == name]
        if other is not None and other.rankings:
            found.append(said(f"{who}, {how}", other))
    return found


def predictions(
    own: Answers | None,
    results: Path,
    lists: Sequence[Iterable[str]],
    measured: str | None = None,
    papers: bool = True,
) -> tuple[tuple[Prediction, ...], list[LeftOut]]:
    """Every prediction that is there, in the order of the columns that show them.

    Args:
        own: of the study's own model.
        results: the folder of all studies, for the probe and short trainings.
        lists: to cut scores of single sets into.
        measured: the study that is to be foretold, which foretells nothing itself.
        papers: whether it has the paper's task and camera sets, which all but its own model
            speak of.

    Returns:
        The predictions, and what could not be read.
    """
    found: list[Prediction] = []
    left_out: list[LeftOut] = []
    if papers:
        found = [said(paper.SOURCE, paper.answers())]
        for told in recorded_answers():
            found += _said_by(told.source, told, RECORDINGS / told.source, ".", left_out)
    if measured is not None:
        mine = _said_by("VLM", own, results / measured, VLM, left_out)
        # A study that replays a recording says nothing that is not there already.
        found += [one for one in mine if all(one.lists != other.lists for other in found)]
    if papers and (results / _PROBE).exists():
        try:
            scores = {one.cameras: one.score for one in read_entries(results / _PROBE, _Probed)}
            found.append(scored("probe", scores, lists))
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / _PROBE, str(error)))
    if papers and measured != _FAST and (results / _FAST).is_dir():
        found.append(scored("fast protocol", _returns(results / _FAST), lists))
    return tuple(one for one in found if one.lists), left_out


def lists_of(answers: Answers | None, papers: bool = True) -> dict[str, tuple[str, ...]]:
    """The paper's lists, if ``papers``, then any others that a model ranked, by name."""
    lists = dict(paper.lists()) if papers else {}
    known = {frozenset(members) for members in lists.values()}
    for ranking in answers.rankings if answers else ():
        if frozenset(ranking.places) not in known:
            lists[f"list {len(lists) + 1}"] = tuple(ranking.places)
    return lists


def said(who: str, answers: Answers) -> Prediction:
    return Prediction(
        who,
        {
            frozenset(ranking.places): {name: -place for name, place in ranking.places.items()}
            for ranking in answers.rankings
        },
        {frozenset(ranking.places): ranking.sure for ranking in answers.rankings},
    )


def scored(
    who: str, scores: Mapping[str, float], lists: Iterable[Iterable[str]], whole: bool = True
) -> Prediction:
    """Scores of single sets, list by list; higher is better.

    Args:
        whole: leave out a list if one of its camera sets has no score; otherwise leave out the set.
    """
    known = set(scores)
    chosen = [m for m in map(frozenset, lists) if (m <= known if whole else m & known)]
    return Prediction(who, {m: {name: scores[name] for name in m & known} for m in chosen})


def _returns(folder: Path) -> dict[str, float]:
    """Returns of a study's finished runs by camera set; its own pages say what is wrong there."""
    ends: dict[str, list[float]] = {}
    for run in read_study(folder).runs:
        end = final(run)
        # Of a labelled run, other settings than its cameras may have decided.
        if end is not None and end.finished and run.config.get("label") is None:
            ends.setdefault(run.place.cameras, []).append(end.value)
    return {cameras: estimate(own).value for cameras, own in ends.items()}
