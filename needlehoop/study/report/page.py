"""Pages of a study: single HTML files that need no network."""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from mimetypes import guess_type
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from needlehoop.runs import files
from needlehoop.study.data import paper
from needlehoop.study.data.paper import reward_label, reward_order
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.figures import Drawn
from needlehoop.study.render.table import Table, percent, written
from needlehoop.study.report.tables import all_tables
from needlehoop.study.stats.findings import StudyFindings

CAMERAS = "cameras"
"""Folder of the cameras' pictures: in a study; for the paper's task, also beside it."""

_FIRST = ("rewards", "final_values")
"""Figures before all others."""

_FILMS = 7_500_000
"""Bytes that a page's films take in it; those beyond are linked to."""


@dataclass(frozen=True)
class Agent:
    """A camera set with one reward, or a run: a line, what it sees, and its film."""

    name: str
    line: str = ""
    images: Sequence[Path] = ()
    film: Path | None = None


@dataclass(frozen=True)
class Section:
    """A part of a page. A template shows what is there, in the order of these fields."""

    title: str
    lines: Sequence[str] = ()
    figures: Sequence[Drawn] = ()
    agents: Sequence[Agent] = ()
    tables: Sequence[Table] = ()
    folded: Sequence[tuple[str, str]] = ()
    """Texts that open at a click, each below its summary."""
    text: str = ""


def write_page(
    out: Path, title: str, sections: Iterable[Section], command: str, opening: str = ""
) -> None:
    """Write a page with as many films in it as fit, and links to the others.

    It names the ``command`` that makes it, and begins with the HTML ``opening``.
    """
    loader = PackageLoader("needlehoop.study.report", "html")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    held = 0

    def address(film: Path) -> str:
        nonlocal held
        # Base64 turns 3 bytes into 4.
        held += film.stat().st_size * 4 // 3
        link = Path(os.path.relpath(film, out.parent)).as_posix()
        return inline(film) if held <= _FILMS else link

    page = environment.get_template("page.html").render(
        title=title, sections=[*sections, Section("This page", text=command)], opening=opening,
        inline=inline, address=address,
    )  # fmt: skip
    files.write_whole(out, page)


def inline(path: Path) -> str:
    """A file as an address that holds it."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{guess_type(path)[0]};base64,{data}"


def write_report(
    parts: Sequence[tuple[StudyFindings, Sequence[Drawn]]],
    out: Path,
    command: str,
    opening: str = "",
) -> None:
    """Write a page of studies, each with its figures; the rest as in ``write_page``."""
    title = " and ".join(findings.title for findings, _ in parts)
    write_page(out, title, (one for part in parts for one in _sections(*part)), command, opening)


def film_of(runs: Sequence[Record]) -> Path | None:
    """The first film that one of these runs has."""
    return next((run.video for run in runs if run.video), None)


def undrawn(study: Study) -> dict[Path, list[str]]:
    """Cameras without a picture, by the folder of a run that can draw them."""
    missing: dict[Path, list[str]] = {}
    first = {name: run for run in reversed(study.runs) for name in run.config["cams"]}
    for name in sorted(first.keys() - _pictures(study).keys()):
        missing.setdefault(first[name].folder, []).append(name)
    return missing


def _pictures(study: Study) -> dict[str, Path]:
    """What agents see, by camera; for the paper's task also beside the study."""
    home = study.folder.resolve()
    places = [home.parent, home] if study.is_of(paper.task()) else [home]
    return {path.stem: path for place in places for path in (place / CAMERAS).glob("*.png")}


def _sections(findings: StudyFindings, figures: Sequence[Drawn]) -> Iterator[Section]:
    study, pictures = findings.study, _pictures(findings.study)
    counts = f"{len(study.runs)} runs, {sum(run.finished for run in study.runs)} finished"
    first = [figure for figure in figures if figure.name in _FIRST]
    yield Section(f"Study {findings.title}", [counts, *study.left_out], first)
    for reward in sorted({one.reward for one in findings.results}, key=reward_order):
        results = [one for one in findings.results if one.reward == reward]
        agents = [
            Agent(
                f"{place}. {entry.cameras}",
                f"{findings.goal}: {percent(entry.success)} of 100, return: {written(entry.value)}"
                + (", still in training" if entry.unfinished else ""),
                [pictures[name] for name in entry.cameras.split("+") if name in pictures],
                film_of(entry.runs),
            )
            for place, entry in enumerate(results, start=1)
        ]
        yield Section(f"Ranking, reward: {reward_label(reward)}", agents=agents)
    tables = [table for table in all_tables(findings) if not table.rows.empty]
    yield Section("Tables", tables=tables)
    yield Section("Training", figures=[one for one in figures if one not in first])
    yield Section("Runs", folded=[(str(run.place), _settings(run)) for run in study.runs])


def _settings(run: Record) -> str:
    """What made a run: its command, its settings and its reward."""
    paths = (run.folder / name for name in (files.CONFIG, files.MANIFEST, files.REWARD))
    texts = (path.read_text(encoding="utf-8") for path in paths if path.exists())
    return "\n\n".join((run.command, *texts))
