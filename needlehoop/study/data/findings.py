"""What a study found, combination by combination: what figures, tables and report show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from needlehoop.study.data import paper
from needlehoop.study.data.answers import Answers, read_answers
from needlehoop.study.data.combinations import HUMAN
from needlehoop.study.data.final import Final, final
from needlehoop.study.data.predictions import Prediction, lists_of, predictions
from needlehoop.study.data.records import LeftOut, Record, Study, read_study
from needlehoop.study.stats.statistics import Estimate, estimate, rate


@dataclass(frozen=True)
class Result:
    """One combination of cameras with one reward, over its seeds."""

    cameras: str
    reward: str
    runs: tuple[Record, ...]
    """Those with a final value; none for the paper's."""
    finals: tuple[Final, ...]
    value: Estimate
    """Of the final return."""
    success: Estimate | None
    """``None`` where only returns were published."""
    cheat: Estimate | None

    @property
    def unfinished(self) -> int:
        """Runs whose final value is of an agent still in training."""
        return sum(not found.finished for found in self.finals)


@dataclass(frozen=True)
class Findings:
    """A study, or the paper's numbers in a study's place."""

    title: str
    study: Study | None
    """``None``: the paper's."""
    results: tuple[Result, ...]
    """The best final return first."""
    answers: Answers | None
    """Of the study's own model."""
    predictions: tuple[Prediction, ...]
    """Of whoever ranked sets of cameras, the study's own model among them."""
    left_out: tuple[LeftOut, ...]

    @property
    def main_reward(self) -> str:
        """The reward under which cameras are compared: the human one, or the commonest."""
        counts = Counter(result.reward for result in self.results)
        return HUMAN if HUMAN in counts or not counts else counts.most_common(1)[0][0]

    @property
    def ranked(self) -> tuple[Result, ...]:
        """Results with the main reward, the best first."""
        return tuple(result for result in self.results if result.reward == self.main_reward)

    @property
    def lists(self) -> dict[str, tuple[str, ...]]:
        """The paper's lists, then any others that the study's VLM ranked."""
        return lists_of(self.answers)

    @property
    def compares_rewards(self) -> bool:
        """Whether rewards are its question, and not cameras: no list has two sets to compare."""
        sets = {result.cameras for result in self.ranked}
        to_rank = any(len(sets.intersection(members)) > 1 for members in self.lists.values())
        return not to_rank and len(sets) < len(self.results)

    @property
    def seeds(self) -> int:
        """The fewest seeds that a result has."""
        return min((result.value.seeds for result in self.results), default=0)


def study_findings(folder: Path) -> Findings:
    """What the runs under a study's folder say.

    Raises:
        ValueError: no such folder.
    """
    study = read_study(folder)
    answers, unread = read_answers(folder)
    foretold, unreadable = predictions(
        answers,
        folder.resolve().parent,
        [*lists_of(answers).values()],
        measured=folder.resolve().name,
    )
    left_out = [*study.left_out, *unread, *unreadable]
    results = []
    for (cameras, reward), runs in groupby(
        study.runs, key=lambda run: (run.place.cameras, run.place.reward)
    ):
        pairs = []
        for run in runs:
            found = final(run)
            if found is None:
                where = run.folder.relative_to(folder)
                left_out.append(LeftOut(where, "not evaluated yet: it has no final value"))
            else:
                pairs.append((run, found))
        if pairs:
            results.append(_result(cameras, reward, pairs))
    results.sort(key=lambda result: (-result.value.value, result.cameras, result.reward))
    title = folder.resolve().name
    return Findings(title, study, tuple(results), answers, foretold, tuple(left_out))


def paper_findings(results: Path) -> Findings:
    """The paper's Table I, Table II and Figure 7, where they are in numbers.

    Args:
        results: the folder of all studies, for what else predicts the paper's order.
    """
    own = paper.answers()
    foretold, left_out = predictions(None, results, [*paper.lists().values()])
    values = {(name, HUMAN): value for name, value in paper.measured().items()}
    values |= {
        (row.cameras, row.reward): row.value for row in paper.rewards() if row.value is not None
    }
    found = [
        Result(cameras, reward, (), (), estimate([[value]]), None, None)
        for (cameras, reward), value in values.items()
    ]
    found.sort(key=lambda result: (-result.value.value, result.cameras, result.reward))
    return Findings("the paper's numbers", None, tuple(found), own, foretold, tuple(left_out))


def _result(cameras: str, reward: str, pairs: Sequence[tuple[Record, Final]]) -> Result:
    finals = tuple(found for _, found in pairs)
    episodes = [found.episodes for found in finals]
    return Result(
        cameras,
        reward,
        tuple(run for run, _ in pairs),
        finals,
        value=estimate([[found.value for found in finals]]),
        success=rate([found.success for found in finals], episodes),
        cheat=rate([found.cheat for found in finals], episodes),
    )
