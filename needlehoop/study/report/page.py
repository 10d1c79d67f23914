"""One page for a study: a single HTML file that needs no network."""

from __future__ import annotations

import base64
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from needlehoop.runs import files
from needlehoop.runs.reading import UnreadableError, read_text
from needlehoop.study.data import paper
from needlehoop.study.data.contents import check_media
from needlehoop.study.data.paper import reward_label
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.figures import Drawn
from needlehoop.study.render.table import Column
from needlehoop.study.report.tables import all_tables, fails_in, list_name
from needlehoop.study.stats.findings import SEVERITY, Result, StudyFindings, robustness
from needlehoop.study.stats.predictions import recorded_answers
from needlehoop.study.stats.run import RETURN, final
from needlehoop.study.stats.statistics import ENOUGH, no_interval

CAMERAS = "cameras"
"""A study's folder with what an agent sees through each camera; for the paper's task, beside it."""

_FIRST = ("rewards", "final_values")
"""Figures before all others."""

_FILMS = 7_500_000
"""Bytes that films take of a page; those beyond are linked to."""

_FILM = 4_000_000
"""Bytes of the longest film that is part of a page."""

_TYPES = {".svg": "image/svg+xml", ".png": "image/png", ".mp4": "video/mp4"}

_NOTED = ("commit", "started", "wall_time", "python", "platform", "cpus", "gpu")
"""What the page shows of a run's manifest."""


def films_of(groups: Iterable[Sequence[Record]]) -> list[Path]:
    """The film of each group of runs that has one: its first."""
    filmed = map(filmed_run, groups)
    return [run.video for run in filmed if run and run.video]


def filmed_run(runs: Sequence[Record]) -> Record | None:
    """The first run that has a film."""
    return next((run for run in runs if run.video is not None), None)


def write_report(
    parts: Sequence[tuple[StudyFindings, Sequence[Drawn]]],
    out: Path,
    command: str,
    opening: str = "",
) -> None:
    """Write the page.

    Args:
        parts: a study, or the paper, with its figures, of which the page holds copies; between
            several the page has a switch.
        out: an HTML file. Films for which it has no room are linked to from its folder; the best
            and the worst of each ranking come first.
        command: that makes this page.
        opening: HTML that stands before the first study.
    """
    told = [_shown(*part, alone=len(parts) == 1) for part in parts]
    title = f"Studies {', '.join(findings.title for findings, _ in parts)}"
    if len(parts) == 1:
        ((findings, _),) = parts
        title = f"Study {findings.title}" if findings.study else "The paper's published numbers"
    wanted = []
    for ranking in (own for findings, _ in parts for own in findings.by_reward.values()):
        # The best and the worst first, the middle last.
        order = sorted(range(len(ranking)), key=lambda i: min(i, len(ranking) - 1 - i))
        wanted.append(films_of(ranking[number].runs for number in order))
    write_page("report.html", out, wanted, title=title, parts=told, opening=opening, made=command)


def write_page(template: str, out: Path, wanted: Sequence[Sequence[Path]], **values: Any) -> None:
    """Write a page of ``html/`` with as many films in it as fit, and links to the others.

    Args:
        template: its name; it gets ``values``.
        out: an HTML file.
        wanted: films of each of its parts, the most wanted first.
    """
    loader = PackageLoader("needlehoop.study.report", "html")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, keep_trailing_newline=True
    )
    environment.globals |= {
        "fails_in": fails_in,
        "filmed_run": filmed_run,
        "happened": _happened,
        "inline": inline,
        "list_name": list_name,
        "outcome": _outcome,
        "reward_label": reward_label,
        "of_return": Column.of(RETURN).text,
        "percent": Column("", form=".0f", scale=100.0).text,
        "tenths": Column("", form=".1f", scale=100.0).text,
        "words": {"ENOUGH": ENOUGH, "SEVERITY": SEVERITY, "one_run": no_interval(1)},
    }
    held = {*_fitting(wanted)}

    def film(path: Path) -> str:
        return inline(path) if path in held else Path(os.path.relpath(path, out.parent)).as_posix()

    page = environment.get_template(template).render(film=film, **values)
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(page, encoding="utf-8")


def inline(path: Path) -> str:
    """A file as an address that holds it."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_TYPES[path.suffix]};base64,{data}"


def _fitting(rankings: Sequence[Sequence[Path]]) -> Iterator[Path]:
    """The films that fit into a page; rankings take turns."""
    room = _FILMS
    for film in (film for turn in zip_longest(*rankings) for film in turn if film):
        size = film.stat().st_size
        # Base64 turns 3 bytes into 4.
        taken = 4 * -(-size // 3)
        if size <= _FILM and taken <= room:
            room -= taken
            yield film


def undrawn(study: Study) -> dict[Path, list[str]]:
    """Cameras without a picture, by the folder of a run that can draw them."""
    found: dict[Path, list[str]] = {}
    for name, run, path in _pictures(study):
        if path is None:
            found.setdefault(run.folder, []).append(name)
    return found


def _pictures(study: Study) -> list[tuple[str, Record, Path | None]]:
    """Each camera of a study, the first run that has it, and its picture if there is one."""
    first = {name: run for run in reversed(study.runs) for name in run.config["cams"]}
    home = study.folder.resolve()
    places = [home, home.parent] if study.is_of(paper.task()) else [home]
    found = []
    for name, run in sorted(first.items()):
        paths = (place / CAMERAS / f"{name}.png" for place in places)
        found.append((name, run, next((path for path in paths if path.exists()), None)))
    return found


def _tiles(study: Study) -> tuple[dict[str, str], list[str]]:
    """What agents see: addresses that hold whole images, by camera; and why some are missing."""
    found: dict[str, str] = {}
    problems = []
    for name, _, path in _pictures(study):
        try:
            if path is None:
                problems.append(f"no picture of {name}")
            else:
                found[name] = inline(check_media(path))
        except UnreadableError as error:
            problems.append(f"{path} {error}; remove it, and it is drawn anew")
    return found, problems


def _shown(findings: StudyFindings, figures: Sequence[Drawn], alone: bool) -> dict[str, Any]:
    """What the template shows of a study."""
    study = findings.study
    ahead = [figure for figure in figures if figure.name in _FIRST and figure.files]
    tiles, problems = _tiles(study) if study else ({}, [])
    speakers = []
    if study and findings.answers and findings.answers.rankings:
        speakers = [findings.answers]
    elif study and findings.is_papers:
        speakers = [*recorded_answers()]
    flat = {run.place: {*run.settings.items()} for run in study.runs} if study else {}
    common = set.intersection(*flat.values()) if len(flat) > 1 else set()
    return {
        "findings": findings,
        # Names of a page's parts are unique in it.
        "mark": "" if alone else f"{findings.title}-",
        "stressed": next((one for one in robustness(findings)[:1] if one.mean), None),
        "tiles": tiles,
        "problems": problems,
        "first": ahead,
        "figures": [figure for figure in figures if figure not in ahead],
        "tables": all_tables(findings),
        "speakers": speakers,
        "common": sorted(common),
        "runs": [
            (run, _facts(run) + sorted(flat[run.place] - common), _reward(run, study.folder))
            for run in study.runs
        ]
        if study
        else [],
    }


def _outcome(result: Result) -> str:
    interval = Column.of(RETURN).text(result.value.interval_or_why)
    found = f"return {result.value.value:.2f} ({interval})"
    if result.success is not None:
        found += f", success {100 * result.success.value:.0f} %"
    return found


def _happened(findings: StudyFindings, cameras: str, listed: Collection[str]) -> str:
    """What the runs made of a predicted camera set, among those that were ranked with it."""
    results = {one.cameras: one for one in findings.ranked if one.cameras in listed}
    if cameras not in results:
        return "Not run yet."
    own = results[cameras]
    place = 1 + sum(one.value.value > own.value.value for one in results.values())
    return f"Measured: place {place} of {len(results)}, {_outcome(own)}."


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
    facts += [(key, str(manifest[key])) for key in _NOTED if manifest.get(key) is not None]
    versions = manifest.get("versions")
    if isinstance(versions, Mapping):
        facts.append(("versions", ", ".join(f"{k} {v}" for k, v in versions.items())))
    return facts


def _reward(run: Record, study: Path) -> str:
    path = run.folder / files.REWARD
    if not os.path.lexists(path):
        return f"{files.REWARD} is not kept; {files.CONFIG} has the reward's values and program"
    try:
        return read_text(path)
    except UnreadableError as error:
        return f"{files.REWARD} {error}"
