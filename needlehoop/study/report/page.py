"""One page for a study: a single HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from needlehoop.runs import files
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.study.data.answers import Answers, Ranking
from needlehoop.study.data.paper import reward_label
from needlehoop.study.data.records import Record
from needlehoop.study.render.figures import Drawn
from needlehoop.study.render.table import Column
from needlehoop.study.report.gallery import (
    Films,
    filmed_run,
    films_of,
    fitting,
    inline,
    rankings_by_reward,
    tiles_of,
)
from needlehoop.study.report.tables import all_tables, list_name, reached
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.predictions import recorded_answers
from needlehoop.study.stats.run import RETURN, final
from needlehoop.study.stats.statistics import ENOUGH, no_interval
from needlehoop.study.stats.stress import SEVERITY, robustness

_FIRST = ("final_values",)
"""Figures before all others."""

_FIRST_OF_REWARDS = ("rewards", "success_and_cheats")
"""The same for a study whose question is rewards."""

_LONGEST = 10_000_000
"""Bytes of a page; films are left out of it to keep to this."""


@dataclass(frozen=True)
class Part:
    """A study of a page."""

    findings: StudyFindings
    """Of a study, or of the paper."""
    figures: Sequence[Drawn]
    """As drawn; the page holds copies."""


def write_report(parts: Sequence[Part], out: Path, command: str, opening: str = "") -> None:
    """Write the page.

    Args:
        parts: one study, or several, between which the page has a switch; all beside each other.
        out: an HTML file. Films for which it has no room are linked to from its folder; the best
            and the worst of each ranking come first.
        command: that makes this page, for the record.
        opening: HTML that stands before the first study.
    """
    told = [_part(part, alone=len(parts) == 1) for part in parts]

    def page(films: Films) -> str:
        values = {"title": _title(parts), "parts": told, "films": films, "opening": opening}
        return render("report.html", **values, made=command)

    write_with_films(page, [films for part in parts for films in films_of(part.findings)], out)


def write_with_films(
    page: Callable[[Films], str], wanted: Sequence[Sequence[Path]], out: Path
) -> None:
    """Write a page with as many films in it as there is room for, and links to the others.

    Args:
        page: as text.
        wanted: films of each of its parts, the most wanted first.
        out: an HTML file.
    """
    # The page with links says how much room films have; a link is as long as a film's tags.
    room = _LONGEST - len(page(Films(out.parent)).encode())
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(page(Films(out.parent, fitting(wanted, room))), encoding="utf-8")


def render(template: str, **values: Any) -> str:
    """A page of ``html/``, with its style and script in it."""
    loader = PackageLoader("needlehoop.study.report", "html")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.globals |= {
        "filmed_run": filmed_run,
        "reward_label": reward_label,
        "of_return": Column.of(RETURN).text,
        "percent": Column("", form=".0f", scale=100.0).text,
        "tenths": Column("", form=".1f", scale=100.0).text,
    }
    css, script = (loader.get_source(environment, f"report.{kind}")[0] for kind in ("css", "js"))
    return environment.get_template(template).render(css=css, script=script, **values)


def _part(part: Part, alone: bool) -> dict[str, Any]:
    """What the page shows of a study."""
    findings = part.findings
    study = findings.study
    figures = [shown_figure(drawn) for drawn in part.figures]
    ahead = _FIRST_OF_REWARDS if findings.compares_rewards else _FIRST
    tiles, problems = tiles_of(study)
    return {
        "findings": findings,
        # Names of a page's parts are unique in it.
        "mark": "" if alone else f"{findings.title}-",
        "lead": _lead(findings),
        "tiles": tiles,
        "problems": problems,
        "first": [figure for figure in figures if figure["name"] in ahead],
        "figures": [figure for figure in figures if figure["name"] not in ahead],
        "rankings": rankings_by_reward(findings),
        "reached": reached(findings),
        "tables": all_tables(findings),
        "reasons": _reasons(findings),
        "answers": findings.answers.questions if study and findings.answers else (),
        **_settings(study.runs if study else (), study and study.folder),
    }


def _title(parts: Sequence[Part]) -> str:
    if len(parts) > 1:
        return f"Studies {', '.join(part.findings.title for part in parts)}"
    (part,) = parts
    found = part.findings
    return f"Study {found.title}" if found.study else "The paper's published numbers"


def _lead(findings: StudyFindings) -> list[str]:
    if findings.study is None:
        return [
            "Returns and rankings as published in K. Raghuvanshi, Leveraging VLMs for Optimising"
            " Camera Inputs for Surgical Robotic Reinforcement Learning. Not measured here.",
            f"One run for each camera set: {no_interval(1)}.",
        ]
    runs = findings.study.runs
    done = sum(run.finished for run in runs)
    lead = [f"{len(runs)} runs, {done} of them finished; {len(findings.left_out)} left out."]
    if findings.ranked:
        best, worst = findings.ranked[0], findings.ranked[-1]
        lead.append(f"Best cameras: {_outcome(best)}.")
        if worst is not best:
            lead.append(f"Worst: {_outcome(worst)}.")
    for one in robustness(findings)[:1]:
        if one.mean is not None:
            lead.append(
                f"Under disturbances {one.result.cameras} does best:"
                f" {100 * one.mean.value:.0f} % at severity {SEVERITY}, mean over axes."
            )
    if any(result.unfinished for result in findings.results):
        lead.append(
            "Values of unfinished runs are of agents still in training: the mean over their"
            " evaluations in the last tenth of the steps so far."
        )
    fewest, most = findings.seeds, max((r.value.seeds for r in findings.results), default=0)
    if fewest:
        seeds = f"{fewest} to {most} seeds" if fewest < most else f"{fewest} seeds"
        lead.append(
            f"{'One seed' if most == 1 else seeds} each. Intervals are 95 %: of returns over seeds,"
            f" where there are {ENOUGH} or more; of rates over seeds as well, over all episodes"
            " (Wilson's) where there are fewer."
        )
    return lead


def _outcome(result: Result) -> str:
    interval = Column.of(RETURN).text(result.value.interval_or_why)
    found = f"{result.cameras}, return {result.value.value:.2f} ({interval})"
    if result.success is not None:
        found += f", success {100 * result.success.value:.0f} %"
    return found


def shown_figure(drawn: Drawn) -> dict[str, str | None]:
    """The sharpest file of a figure, inline."""
    best = sorted(drawn.files, key=lambda path: path.suffix != ".svg")
    return {
        "name": drawn.name,
        "caption": drawn.caption,
        "missing": drawn.missing,
        "image": inline(best[0]) if best else None,
    }


def _reasons(findings: StudyFindings) -> list[dict[str, Any]]:
    """Each ranking with its reasons, and what the runs made of it.

    Of the study's own model; where it asked none, of the shipped recordings'.
    """
    if findings.study is None:
        return []
    own = findings.answers
    speakers = (own,) if own and own.rankings else recorded_answers() if findings.is_papers else ()
    return [
        _ranking(findings, speaker, ranking) for speaker in speakers for ranking in speaker.rankings
    ]


def _ranking(findings: StudyFindings, answers: Answers, ranking: Ranking) -> dict[str, Any]:
    by_name = {result.cameras: result for result in findings.ranked}
    values = {c: by_name[c].value.value for c in ranking.places if c in by_name}
    places = []
    for cameras, predicted in ranking.places.items():
        happened = "Not run yet."
        if cameras in values:
            place = 1 + sum(value > values[cameras] for value in values.values())
            outcome = _outcome(by_name[cameras]).partition(", ")[2]
            happened = f"Measured: place {place} of {len(values)}, {outcome}."
        places.append(
            {
                "cameras": cameras,
                "predicted": f"{predicted:g}",
                "reason": ranking.reasons.get(cameras, ""),
                "happened": happened,
            }
        )
    return {
        "name": f"{answers.source}: {list_name(findings, frozenset(ranking.places))}",
        "places": places,
    }


def _settings(runs: Sequence[Record], study: Path | None) -> dict[str, Any]:
    """What all runs share, and what each has of its own."""
    flat = [run.settings for run in runs]
    shared = set.intersection(*(set(own.items()) for own in flat)) if len(flat) > 1 else set()
    return {
        "common": sorted(shared),
        "runs": [
            {
                "place": run.place,
                "own": _facts(run) + sorted(set(own.items()) - shared),
                "reward": _reward(run, study),
                "command": run.command,
            }
            for run, own in zip(runs, flat, strict=True)
        ],
    }


def _facts(run: Record) -> list[tuple[str, str]]:
    """What the manifest and the final value say of a run."""
    found, manifest = final(run), run.manifest
    facts = [("state", "finished" if run.finished else "not finished")]
    facts.append(("trained", f"{run.steps} of {run.planned_steps} steps"))
    if found is not None:
        facts.append(("final return", f"{found.value:.3f} over {found.episodes} episodes"))
        cheat = "" if found.cheat is None else f", cheat {found.cheat:.3f}"
        facts.append(("final success", f"{found.success:.3f}{cheat}"))
    facts.append(("reward", reward_label(run.place.reward)))
    for key in ("commit", "started", "wall_time", "python", "platform", "cpus", "gpu"):
        if manifest.get(key) is not None:
            facts.append((key, str(manifest[key])))
    versions = manifest.get("versions")
    if isinstance(versions, Mapping):
        facts.append(("versions", ", ".join(f"{k} {v}" for k, v in versions.items())))
    return facts


def _reward(run: Record, study: Path | None) -> str:
    path = run.folder / files.REWARD
    if not (path.exists() or path.is_symlink()):
        return f"{files.REWARD} is not kept; {files.CONFIG} has the reward's values and program"
    try:
        return read_text(path, within=study)
    except UnreadableError as error:
        return f"{files.REWARD} {error}"
