"""One page for a study: a single HTML file that needs no network."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from needlehoop.runs import files
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.study import paper
from needlehoop.study.answers import Answers
from needlehoop.study.combinations import LISTS, label, reward_label
from needlehoop.study.figures import Drawn
from needlehoop.study.final import final
from needlehoop.study.findings import Findings, Result
from needlehoop.study.predictions import recorded_answers
from needlehoop.study.records import Record
from needlehoop.study.statistics import ENOUGH, no_interval
from needlehoop.study.tables import all_tables

_EMBED = 4_000_000
"""Bytes of a film, at most, to be part of the page; a larger one is linked to."""

_TYPES = {".svg": "image/svg+xml", ".png": "image/png", ".mp4": "video/mp4"}


def write_report(findings: Findings, figures: Sequence[Drawn], out: Path, command: str) -> None:
    """Write the page.

    Args:
        findings: of a study, or of the paper.
        figures: as drawn; the page holds copies.
        out: an HTML file. Films too large to be part of it are linked to from its folder.
        command: that makes this page, for the record.
    """
    environment = Environment(
        loader=PackageLoader("needlehoop.study", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    page = environment.get_template("report.html").render(
        title=_title(findings),
        css=_own(environment, "report.css"),
        script=_own(environment, "report.js"),
        lead=_lead(findings),
        figures=[_figure(drawn) for drawn in figures],
        tables=all_tables(findings),
        is_study=findings.study is not None,
        films=_films(findings, out.parent),
        reasons=_reasons(findings),
        answers=findings.answers.questions if findings.study and findings.answers else (),
        made=command,
        left_out=findings.left_out,
        **_settings(findings),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(page, encoding="utf-8")


def _own(environment: Environment, name: str) -> str:
    """A file of ours that goes into the page as it is."""
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]


def _title(findings: Findings) -> str:
    return f"Study {findings.title}" if findings.study else "The paper's published numbers"


def _lead(findings: Findings) -> list[str]:
    if findings.study is None:
        return [
            "Returns and rankings as published in K. Raghuvanshi, Leveraging VLMs for Optimising"
            " Camera Inputs for Surgical Robotic Reinforcement Learning. Not measured here.",
            f"One run for each combination: {no_interval(1)}.",
        ]
    runs = findings.study.runs
    done = sum(run.finished for run in runs)
    lead = [f"{len(runs)} runs, {done} of them finished; {len(findings.left_out)} left out."]
    if findings.ranked:
        best, worst = findings.ranked[0], findings.ranked[-1]
        lead.append(f"Best cameras: {_outcome(best)}.")
        if worst is not best:
            lead.append(f"Worst: {_outcome(worst)}.")
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
    found = f"{label(result.cameras)}, return {result.value.value:.2f} ({result.value.interval})"
    if result.success is not None:
        found += f", success {100 * result.success.value:.0f} %"
    return found


def _figure(drawn: Drawn) -> dict[str, str | None]:
    """The sharpest file of a figure, inline."""
    best = sorted(drawn.files, key=lambda path: path.suffix != ".svg")
    return {
        "name": drawn.name,
        "caption": drawn.caption,
        "missing": drawn.missing,
        "image": _inline(best[0]) if best else None,
    }


def _inline(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_TYPES[path.suffix]};base64,{data}"


def _films(findings: Findings, folder: Path) -> list[dict[str, Any]]:
    """The best and the worst run with a film, by final return."""
    filmed = [
        (found, run, run.video)
        for result in findings.ranked
        for run, found in zip(result.runs, result.finals, strict=True)
        if run.video is not None
    ]
    filmed.sort(key=lambda entry: (-entry[0].value, entry[1].place))
    chosen = filmed[:1] + filmed[1:][-1:]
    films = []
    for which, (found, run, video) in zip(("Best", "Worst"), chosen, strict=False):
        embedded = video.stat().st_size <= _EMBED
        link = Path(os.path.relpath(video, folder)).as_posix()
        films.append(
            {
                "embedded": embedded,
                "source": _inline(video) if embedded else link,
                "caption": f"{which}: {run.place}, return {found.value:.2f},"
                f" success {100 * found.success:.0f} %",
            }
        )
    return films


def _reasons(findings: Findings) -> list[dict[str, Any]]:
    """Each ranking with its reasons, and what the runs made of it.

    Of the study's own model; where it asked none, of the shipped recordings'.
    """
    if findings.study is None:
        return []
    own = findings.answers
    speakers = (own,) if own and own.rankings else recorded_answers()
    return [
        _ranking(findings, speaker, number)
        for speaker in speakers
        for number in range(len(speaker.rankings))
    ]


def _ranking(findings: Findings, answers: Answers, number: int) -> dict[str, Any]:
    ranking = answers.rankings[number]
    by_name = {result.cameras: result for result in findings.ranked}
    values = {c: by_name[c].value.value for c in ranking.places if c in by_name}
    names = [
        LISTS[name]
        for name, members in paper.lists().items()
        if set(members) == set(ranking.places)
    ]
    places = []
    for cameras, predicted in ranking.places.items():
        happened = "Not run yet."
        if cameras in values:
            place = 1 + sum(value > values[cameras] for value in values.values())
            outcome = _outcome(by_name[cameras]).partition(", ")[2]
            happened = f"Measured: place {place} of {len(values)}, {outcome}."
        places.append(
            {
                "cameras": label(cameras),
                "predicted": f"{predicted:g}",
                "reason": ranking.reasons.get(cameras, ""),
                "happened": happened,
            }
        )
    name = names[0] if names else f"List {number + 1}"
    return {"name": f"{answers.source}: {name}", "places": places}


def _settings(findings: Findings) -> dict[str, Any]:
    """What all runs share, and what each has of its own."""
    runs = findings.study.runs if findings.study else ()
    flat = [dict(_flatten(run.config)) for run in runs]
    shared = {
        key: value
        for key, value in (flat[0].items() if flat else ())
        if all(key in other and other[key] == value for other in flat)
    }
    return {
        "common": sorted(shared.items()) if len(runs) > 1 else [],
        "runs": [
            {
                "place": str(run.place),
                "own": _facts(run)
                + sorted((k, v) for k, v in own.items() if len(runs) == 1 or k not in shared),
                "reward": _reward(run, findings.study.folder if findings.study else None),
                "command": f"{run.command or '(command not on record)'}  # {run.place}",
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
        facts.append(("final success", f"{found.success:.3f}, cheat {found.cheat:.3f}"))
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
    try:
        return read_text(path, within=study)
    except UnreadableError as error:
        return f"{files.REWARD} {error}"


def _flatten(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Settings as ``algo.gamma``, as they are typed on the command line."""
    pairs = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            pairs += _flatten(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", _typed(value)))
    return pairs


def _typed(value: Any) -> str:
    """A value as Hydra takes it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, list):
        return f"[{','.join(map(_typed, value))}]"
    return str(value)
