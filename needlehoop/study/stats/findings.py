"""What a study found, camera set by camera set: what figures, tables and report show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from statistics import mode

import numpy as np

from needlehoop.study.data import paper
from needlehoop.study.data.answers import VLM, Answers, read_answers
from needlehoop.study.data.paper import HUMAN
from needlehoop.study.data.records import Record, Study, read_study
from needlehoop.study.stats.predictions import (
    MEASURED,
    PAPERS_MEASURED,
    Prediction,
    predictions,
    scored,
)
from needlehoop.study.stats.run import RETURN, SUCCESS, TRAINING, Final, final
from needlehoop.study.stats.statistics import Estimated, estimate, iqm, rate


@dataclass(frozen=True)
class Result:
    """One camera set with one reward, over its seeds."""

    cameras: str
    reward: str
    runs: Sequence[Record]
    """Runs with a final value."""
    finals: Sequence[Final]

    @property
    def value(self) -> Estimated:
        """The final return."""
        return estimate(self.values(RETURN))

    @property
    def success(self) -> Estimated:
        return rate(self.values(SUCCESS), [end.episodes for end in self.finals])

    @property
    def unfinished(self) -> int:
        """Runs whose final value is of an agent still in training."""
        return sum(not end.finished for end in self.finals)

    def values(self, measure: str) -> list[float]:
        """A number of each run; empty where one run has no such number."""
        known = [end.measures[measure] for end in self.finals if measure in end.measures]
        return known if len(known) == len(self.finals) else []

    def middle(self, measure: str) -> float | None:
        """Its interquartile mean over seeds; ``None`` where a run has no such number."""
        values = self.values(measure)
        return float(iqm(np.array(values))) if values else None


@dataclass(frozen=True)
class StudyFindings:
    """What the runs of a study say."""

    study: Study
    results: Sequence[Result]
    """The best final return first."""
    answers: Answers | None
    """What the study's own model said."""
    lists: Mapping[str, Sequence[str]]
    """The paper's lists, if the study has its camera sets; then lists that only its own model
    ranked."""
    predictions: Sequence[Prediction]
    """Of everyone who ranked camera sets, the study's own model among them."""
    is_papers: bool
    """Whether the paper's numbers say something of it: its task, and one of its camera sets."""

    @property
    def title(self) -> str:
        return self.study.folder.resolve().name

    @property
    def main_reward(self) -> str:
        """The reward under which cameras are compared: the human one, or the commonest."""
        rewards = [result.reward for result in self.results]
        return HUMAN if HUMAN in rewards or not rewards else mode(rewards)

    @property
    def goal(self) -> str:
        """The fact that says that the task is done; ``success`` where runs differ in it."""
        goals = {run.task.goal for run in self.study.runs}
        return goals.pop() if len(goals) == 1 else SUCCESS

    @property
    def ranked(self) -> list[Result]:
        """Results with the main reward, the best first."""
        return [result for result in self.results if result.reward == self.main_reward]

    def by_set(self, measure: str) -> dict[str, list[float]]:
        """A number of each run with the main reward, by camera set, the best final return first.

        Camera sets with a run that has no such number are left out.
        """
        return {one.cameras: values for one in self.ranked if (values := one.values(measure))}

    @property
    def truths(self) -> dict[str, Mapping[str, float]]:
        """What predictions are held against: values by camera set, by what they are."""
        ours: dict[str, Mapping[str, float]] = {
            name: {cams: float(iqm(np.array(values))) for cams, values in self.by_set(of).items()}
            for name, of in ((MEASURED, RETURN), (TRAINING, TRAINING))
        }
        return ours | ({PAPERS_MEASURED: paper.measured()} if self.is_papers else {})

    @property
    def rankings(self) -> list[Prediction]:
        """Predictions, then measurements."""
        truths = (
            scored(name, values, self.lists.values(), whole=name == PAPERS_MEASURED)
            for name, values in self.truths.items()
        )
        return [*self.predictions, *(one for one in truths if one.lists or one.source != TRAINING)]

    def predictions_of(self, truth: str) -> list[Prediction]:
        """Those that are held against one of ``truths``; the paper's returns against ours."""
        if not self.is_papers or truth == PAPERS_MEASURED:
            return [*self.predictions]
        published = scored(PAPERS_MEASURED, paper.measured(), paper.lists().values())
        return [*self.predictions, published]


def study_findings(folder: Path) -> StudyFindings:
    """What the runs under a study's folder say."""
    study, answers = read_study(folder), read_answers(folder / VLM)
    papers = study.is_of(paper.task()) and any(
        run.place.cameras in paper.measured() for run in study.runs
    )
    lists: dict[str, Sequence[str]] = {**paper.lists()} if papers else {}
    known = {frozenset(members) for members in lists.values()}
    for ranking in answers.rankings if answers else ():
        if frozenset(ranking.places) not in known:
            lists[f"list {len(lists) + 1}"] = [*ranking.places]
    foretold = predictions(answers, folder.resolve(), [*lists.values()], papers)
    groups = groupby(study.runs, key=lambda run: (run.place.cameras, run.place.reward))
    results = [result for _, runs in groups if (result := result_of([*runs])) is not None]
    results.sort(key=lambda result: (-result.value.value, result.cameras, result.reward))
    return StudyFindings(study, results, answers, lists, foretold, papers)


def result_of(runs: Sequence[Record]) -> Result | None:
    """The result of runs with one camera set and one reward; ``None`` if none has a final value."""
    known = [(run, end) for run in runs if (end := final(run)) is not None]
    if not known:
        return None
    return Result(runs[0].place.cameras, runs[0].place.reward, *zip(*known, strict=True))
