"""Commands that read the files of a study's runs: its figures, tables, pages and best agents."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import argument, command
from needlehoop.runs.files import CONFIG

if TYPE_CHECKING:
    from needlehoop.study.stats.findings import StudyFindings

PAPER = "paper"

_LONGEST = 100
"""Letters of a folder's name."""

_STUDY = "a study's folder, such as results/main; or the word paper: the paper's published numbers"
_OUT = "where to write (the study's folder; of the paper's numbers, results/paper; of several"
_OUT += " folders, one beside the first that has all their names, as a_vs_b)"


def _one_study(help_: str = _STUDY, **more: Any) -> Any:
    return argument("study", metavar="STUDY", help=help_, **more)


def _out(help_: str = _OUT, **more: Any) -> Any:
    return argument("--out", type=Path, metavar="FOLDER", help=help_, **more)


@command(_one_study(), _out())
def plot(options: argparse.Namespace) -> None:
    """Draw a study's figures and write its tables."""
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.tables import write_tables

    findings, out = _open(options.study, options.out)
    for drawn in draw(findings, out / "figures"):
        for path in drawn.files:
            print(path)
        if drawn.missing:
            print(f"{drawn.name}: not drawn, {drawn.missing}")
    for path in write_tables(findings, out / "tables"):
        print(path)
    _say_left_out(findings)


@command(_one_study(f"{_STUDY}; of several, one page with a switch", nargs="+"), _out())
def report(options: argparse.Namespace) -> None:
    """Write a study's report: one HTML page with everything in it."""
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.page import write_report

    opened = [_open(study, options.out) for study in _named(options)]
    if len(opened) == 1:
        out = opened[0][1]
    else:
        titles = [findings.title for findings, _ in opened]
        if len({*titles}) < len(titles):
            raise ValueError(f"studies: {', '.join(titles)} are not different names")
        out = options.out or opened[0][1].parent / _joint(titles, "_and_")
    parts = []
    for findings, _ in opened:
        _draw_cameras(findings)
        figures = out / "figures" if len(opened) == 1 else out / "figures" / findings.title
        parts.append((findings, draw(findings, figures)))
    page = out / "report.html"
    write_report(parts, page, f"needlehoop report {' '.join(options.study)}")
    print(page)
    for findings, _ in opened:
        _say_left_out(findings)


def _draw_cameras(findings: StudyFindings) -> None:
    """Draw what a study's cameras see where there is no picture yet, from its runs' settings."""
    from needlehoop.study.report.page import CAMERAS, undrawn

    study = findings.study
    if study is None or not (missing := undrawn(study)):
        return

    # They import torch.
    from needlehoop.envs.settings import recall_task
    from needlehoop.learning.job import checked_job
    from needlehoop.pictures.stills import tiles
    from needlehoop.rewards import NONE
    from needlehoop.runs.run import Run

    for folder, cams in missing.items():
        try:
            values = Run.open(folder).config()
            recall_task(values, trust=False)
            images = tiles(replace(checked_job(values).env, reward=NONE), cams)
        except (ValueError, RuntimeError, KeyError) as error:
            why = f"{folder} has settings without {error}" if type(error) is KeyError else error
            print(f"no picture of {', '.join(cams)}: {why}")
            continue
        for name, image in images.items():
            path = study.folder / CAMERAS / f"{name}.png"
            path.parent.mkdir(exist_ok=True)
            image.save(path)
            print(path)


@command(argument("study", metavar="FOLDER", nargs="+", help="of runs, or of studies"), _out())
def compare(options: argparse.Namespace) -> None:
    """Set runs, or studies with other settings, beside each other.

    Prints the settings that differ, the evaluations with the difference and its interval, and how
    soon each run got how far. Writes these, learning curves and the films as one HTML page.
    Studies are compared where they have runs of the same cameras and reward.
    """
    from needlehoop.study.data.records import read_run, read_study
    from needlehoop.study.render.figures import Drawn
    from needlehoop.study.render.style import save, styled
    from needlehoop.study.report import comparison
    from needlehoop.study.report.page import films_of, write_page

    folders = [Path(study) for study in _named(options)]
    runs = [folder for folder in folders if (folder / CONFIG).is_file()]
    if runs and len(runs) < len(folders):
        raise ValueError(f"{runs[0]} is a run, and others are studies; name one kind of them")
    studies = [(read_run if runs else read_study)(folder) for folder in folders]
    if runs:
        of = "run"
        found = [comparison.compared_runs([run for study in studies for run in study.runs])]
        beside = Path(os.path.relpath(os.path.commonpath([*map(os.path.abspath, folders)])))
    else:
        of, found, beside = "study", comparison.comparisons(studies), folders[0].parent
    names = [*dict.fromkeys(name for one in found for name in one.runs)]
    out = options.out or beside / _joint([name.replace("/", "-") for name in names], "_vs_")
    tables = [comparison.differences(found, of), comparison.outcomes(found, of),
              comparison.progress(found, of)]  # fmt: skip
    for table in tables:
        print(table.text())
        table.write(out)
    shown = []
    for one in found:
        with styled():
            files = save(comparison.comparison_chart(one), out / one.file)
        chart = Drawn(one.file, f"{one.title}: learning curves.", tuple(files), None)
        shown.append((one, chart))
    page = out / "comparison.html"
    typed = f"needlehoop compare {' '.join(options.study)}"
    films = [films_of(one.runs.values()) for one in found]
    title = " and ".join(names)
    write_page("comparison.html", page, films, title=title, tables=tables, shown=shown, made=typed)
    print(f"{page}; its tables and charts are beside it")
    for study in studies:
        for one in study.left_out:
            print(f"left out: {study.folder}/{one}")


def _joint(names: list[str], word: str) -> str:
    """A folder's name from several."""
    joint = word.join(names)
    return joint if len(joint) <= _LONGEST else f"{names[0]}{word}{len(names) - 1}_others"


def _named(options: argparse.Namespace) -> list[str]:
    """The studies that are named; a setting is none."""
    for study in options.study:
        if "=" in study:
            raise ValueError(f"{study!r} is not understood; it takes studies")
    return options.study


@command(_one_study("a study's folder", type=Path))
def status(options: argparse.Namespace) -> None:
    """Show what of a study is done, running, stopped, failed or missing.

    Missing are the runs that a sweep has tried, and every seed of one run for all others.
    """
    from needlehoop.study.data.records import Study, read_study
    from needlehoop.study.report.status import describe, read_job_ends, standings

    ends, unread = read_job_ends(options.study)
    # Before its first run a sweep's study has no folder.
    begun = options.study.exists() or not ends
    study = read_study(options.study) if begun else Study(options.study, (), ())
    study = replace(study, left_out=(*study.left_out, *unread))
    print(describe(standings(study, ends), study))


@command(
    _one_study(),
    argument("--count", type=int, metavar="N", help="how many (3, or all where there are fewer)"),
)
def top(options: argparse.Namespace) -> None:
    """Print a study's best camera sets by measured return, as cams= takes them."""
    findings, _ = _open(options.study, None)
    ranked = findings.ranked
    # The paper gave three camera sets other rewards.
    count = min(3, len(ranked)) if options.count is None else options.count
    if not 1 <= count <= len(ranked):
        raise ValueError(f"count: {count}; {options.study} has {len(ranked)} camera sets")
    print(",".join(f"[{one.cameras.replace('+', ',')}]" for one in ranked[:count]))


def _open(study: str, out: Path | None) -> tuple[StudyFindings, Path]:
    """What is to be shown, and the folder for it."""
    from needlehoop.study.stats.findings import paper_findings, study_findings

    if study == PAPER:
        return paper_findings(Path("results")), out or Path("results") / PAPER
    folder = Path(study)
    findings = study_findings(folder)
    if not findings.results:
        reasons = "".join(f"\n  {one}" for one in findings.left_out)
        raise ValueError(f"{folder}: no run with a final value yet{reasons}")
    return findings, out or folder


def _say_left_out(findings: StudyFindings) -> None:
    if findings.left_out:
        print(f"left out: {len(findings.left_out)}", *findings.left_out, sep="\n  ")
