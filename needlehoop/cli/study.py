"""Commands that read the files of a study's runs: its figures, tables and pages."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from needlehoop.cli.command import argument, command
from needlehoop.runs.files import CONFIG

if TYPE_CHECKING:
    from needlehoop.study.stats.findings import StudyFindings

_STUDY = "a study's folder, such as results/main"
_BESIDE = "where to write (the study's folder; of several, a folder beside the first, as a_vs_b)"
_OUT = argument("--out", type=Path, metavar="FOLDER", help=_BESIDE)


@command(argument("study", metavar="STUDY", help=_STUDY), _OUT)
def plot(options: argparse.Namespace) -> None:
    """Draw a study's figures and write its tables."""
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.tables import all_tables

    findings = _open(options.study)
    out = options.out or findings.study.folder
    for drawn in draw(findings, out / "figures"):
        print(drawn.file)
    for table in all_tables(findings):
        for path in table.write(out / "tables"):
            print(path)
    _say_left_out(findings)


@command(
    argument("study", metavar="STUDY", help=f"{_STUDY}; of several, one page", nargs="+"), _OUT
)
def report(options: argparse.Namespace) -> None:
    """Write a study's report: one HTML page with everything in it."""
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.page import write_report

    opened = [_open(study) for study in options.study]
    folder, titles = opened[0].study.folder, [findings.title for findings in opened]
    if len({*titles}) < len(titles):
        raise ValueError(f"studies: {', '.join(titles)} are not different names")
    beside = folder if len(opened) == 1 else folder.parent / _joint(titles, "_and_")
    out, parts = options.out or beside, []
    for findings in opened:
        _draw_cameras(findings)
        figures = out / "figures" / (findings.title if len(opened) > 1 else "")
        parts.append((findings, draw(findings, figures)))
    page = out / "report.html"
    write_report(parts, page, f"needlehoop report {' '.join(options.study)}")
    print(page)
    for findings in opened:
        _say_left_out(findings)


def _draw_cameras(findings: StudyFindings) -> None:
    """Draw what a study's cameras see where there is no picture yet, from its runs' settings."""
    from needlehoop.study.report.page import CAMERAS, undrawn

    study = findings.study
    if not (missing := undrawn(study)):
        return

    # They import torch.
    from needlehoop.envs.settings import import_task
    from needlehoop.learning.job import checked_job
    from needlehoop.pictures.stills import tiles
    from needlehoop.rewards import NONE
    from needlehoop.runs.run import Run

    for folder, cams in missing.items():
        try:
            values = Run.open(folder).config()
            import_task(values, trust=False)
            images = tiles(replace(checked_job(values).env, reward=NONE), cams)
        except (ValueError, RuntimeError, KeyError) as error:
            print(f"no picture of {', '.join(cams)}: {folder}: {error}")
            continue
        for name, image in images.items():
            path = study.folder / CAMERAS / f"{name}.png"
            path.parent.mkdir(exist_ok=True)
            image.save(path)
            print(path)


@command(argument("study", metavar="FOLDER", nargs="+", help="of runs, or of studies"), _OUT)
def compare(options: argparse.Namespace) -> None:
    """Set runs, or studies with other settings, beside each other.

    Prints the settings that differ, the evaluations with the difference and its interval, and how
    soon each run got how far. Writes these, learning curves and the films as one HTML page.
    Studies are compared where they have runs of the same cameras and reward.
    """
    from needlehoop.study.data.records import read_run, read_study
    from needlehoop.study.report import comparison

    folders = [Path(study) for study in options.study]
    runs = [folder for folder in folders if (folder / CONFIG).is_file()]
    if runs and len(runs) < len(folders):
        raise ValueError(f"{runs[0]} is a run, and others are studies; name one kind of them")
    studies = [(read_run if runs else read_study)(folder) for folder in folders]
    if runs:
        of = "run"
        comparisons = [comparison.compared_runs([run for study in studies for run in study.runs])]
        beside = Path(os.path.relpath(os.path.commonpath([*map(os.path.abspath, folders)])))
    else:
        of, comparisons, beside = "study", comparison.comparisons(studies), folders[0].parent
    names = [*dict.fromkeys(name for comparison in comparisons for name in comparison)]
    out = options.out or beside / _joint([name.replace("/", "-") for name in names], "_vs_")
    typed = f"needlehoop compare {' '.join(options.study)}"
    for table in comparison.write_comparison(comparisons, of, out, typed):
        print(table.text())
    page = out / "comparison.html"
    print(f"{page}; its tables and charts are beside it")
    for study in studies:
        for entry in study.left_out:
            print(f"left out: {study.folder}/{entry}")


def _joint(names: list[str], word: str) -> str:
    """A folder's name from several, which a file system takes."""
    joint = word.join(names)
    return joint if len(joint) <= 100 else f"{names[0]}{word}{len(names) - 1}_others"


@command(argument("study", metavar="STUDY", help="a study's folder", type=Path))
def status(options: argparse.Namespace) -> None:
    """Show what of a study is done, running, stopped, failed or missing.

    Expected is every pair of cameras and reward that is there with every seed that any has, and
    what sweeps have tried.
    """
    from needlehoop.study.data.records import read_study
    from needlehoop.study.report.status import describe, read_job_ends, standings

    ends = read_job_ends(options.study)
    study = read_study(options.study)
    print(describe(standings(study, ends), study))


def _open(study: str) -> StudyFindings:
    """What is to be shown."""
    from needlehoop.study.stats.findings import study_findings

    findings = study_findings(Path(study))
    if not findings.results:
        reasons = "".join(f"\n  {entry}" for entry in findings.study.left_out)
        raise ValueError(f"{study}: no run with a final value yet{reasons}")
    return findings


def _say_left_out(findings: StudyFindings) -> None:
    if findings.study.left_out:
        print(f"left out: {len(findings.study.left_out)}", *findings.study.left_out, sep="\n  ")
