"""``needlehoop plot``, ``report``, ``compare``, ``status`` and ``top``."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from needlehoop.study.stats.findings import StudyFindings

PAPER = "paper"

_TOP = 3
"""Camera sets that the paper gave other rewards."""

_STUDY = "a study's folder, such as results/main; or the word paper: the paper's published numbers"


def add_commands(commands: Any) -> None:
    """Add the commands to the subparsers of ``needlehoop``."""
    for name, run, summary in (
        ("plot", _plot, "Draw a study's figures and write its tables."),
        ("report", _report, "Write a study's report: one HTML page with everything in it."),
    ):
        command = commands.add_parser(name, help=summary, description=summary)
        if name == "plot":
            command.add_argument("study", metavar="STUDY", help=_STUDY)
        else:
            several = f"{_STUDY}; of several, beside each other, one page with a switch"
            command.add_argument("study", metavar="STUDY", nargs="+", help=several)
        command.add_argument(
            "--out",
            type=Path,
            metavar="FOLDER",
            help="where to write (the study's folder; for the paper's numbers, results/paper;"
            " for several studies, a folder beside the first that has all their names)",
        )
        command.set_defaults(run=run, overrides=[])
    summary = "Set studies with other settings beside each other, cameras by cameras."
    command = commands.add_parser(
        "compare",
        help=summary,
        description=summary,
        epilog="Prints the settings that differ and how soon each run got how far, and draws"
        " learning curves. Studies: folders with runs of the same cameras and reward.",
    )
    command.add_argument("study", metavar="STUDY", nargs="+", help="a study's folder")
    command.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="where to write (comparison, in the folder that the studies are in)",
    )
    command.set_defaults(run=_compare, overrides=[])
    summary = "Show what of a study is done, running, stopped, failed or missing."
    command = commands.add_parser(
        "status",
        help=summary,
        description=summary,
        epilog="With the words of a sweep (experiment=table2 seed=0,1,2; or cams=… reward=…"
        " seed=…), its runs, those included that nobody has started. Without, the runs that are"
        " there or that sweeps have tried, and every seed of one for all others.",
    )
    command.add_argument("study", type=Path, metavar="STUDY", help="a study's folder")
    command.add_argument("overrides", nargs="*", metavar="key=value")
    command.set_defaults(run=_status)
    summary = "Print a study's best camera sets by measured return, as cams= takes them."
    command = commands.add_parser("top", help=summary, description=summary)
    command.add_argument("study", metavar="STUDY", help=_STUDY)
    command.add_argument(
        "--count", type=int, metavar="N", help="how many (3, or all where there are fewer)"
    )
    command.set_defaults(run=_top, overrides=[], out=None)


def _plot(options: argparse.Namespace) -> None:
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.tables import write_tables

    _no_more(options)
    findings, out = _open(options.study, options.out)
    for drawn in draw(findings, out / "figures"):
        for path in drawn.files:
            print(path)
        if drawn.missing:
            print(f"{drawn.name}: not drawn, {drawn.missing}")
    for path in write_tables(findings, out / "tables"):
        print(path)
    _say_left_out(findings)


def _report(options: argparse.Namespace) -> None:
    from needlehoop.study.render.figures import draw
    from needlehoop.study.report.page import Part, write_report

    _no_more(options)
    words = [_word(study) for study in options.study]
    opened = [_open(word, options.out) for word in words]
    if len(opened) == 1:
        out = opened[0][1]
    else:
        titles = [findings.title for findings, _ in opened]
        if len({*titles}) < len(titles):
            raise ValueError(f"studies: {', '.join(titles)} are not different names")
        out = options.out or opened[0][1].parent / "_and_".join(titles)
    for findings, _ in opened:
        _draw_cameras(findings)
    parts = []
    for findings, _ in opened:
        figures = out / "figures" if len(opened) == 1 else out / "figures" / findings.title
        parts.append(Part(findings, draw(findings, figures)))
    page = out / "report.html"
    write_report(parts, page, f"needlehoop report {' '.join(words)}")
    print(page)
    for findings, _ in opened:
        _say_left_out(findings)


def _draw_cameras(findings: StudyFindings) -> None:
    """Draw what a study's cameras see where there is no picture yet, from its runs' settings."""
    from needlehoop.study.report.gallery import CAMERAS, undrawn

    study = findings.study
    for folder, cams in undrawn(study).items() if study else ():
        try:
            images = _seen(folder, cams)
        except (ValueError, RuntimeError, KeyError) as error:
            why = f"{folder} has settings without {error}" if type(error) is KeyError else error
            print(f"no picture of {', '.join(cams)}: {why}")
            continue
        for name, image in images.items():
            path = study.folder / CAMERAS / f"{name}.png"
            path.parent.mkdir(exist_ok=True)
            image.save(path)
            print(path)


def _seen(folder: Path, cams: list[str]) -> dict[str, Any]:
    """Pictures by camera, from a run's own settings."""
    from needlehoop.envs.settings import recall_task
    from needlehoop.learning.job import checked_job
    from needlehoop.pictures.stills import tiles
    from needlehoop.rewards import NONE
    from needlehoop.runs.run import Run

    values = Run.open(folder).config()
    recall_task(values, trust=False)
    return tiles(replace(checked_job(values).env, reward=NONE), cams)


def _compare(options: argparse.Namespace) -> None:
    from needlehoop.study.data.records import read_study
    from needlehoop.study.render.style import save, styled
    from needlehoop.study.report.comparison import (
        comparison_chart,
        comparisons,
        differences,
        progress,
    )

    _no_more(options)
    studies = [read_study(Path(_word(study))) for study in options.study]
    found = comparisons(studies)
    out = options.out or _beside([study.folder for study in studies]) / "comparison"
    for table in (differences(found), progress(found)):
        print(table.text())
        for path in table.write(out):
            print(path)
        print()
    for one in found:
        with styled():
            for path in save(comparison_chart(one), out / f"{one.cameras}_{one.reward}"):
                print(path)
    for study in studies:
        for left in study.left_out:
            print(f"left out: {study.folder}/{left}")


def _beside(folders: list[Path]) -> Path:
    """The folder that all of these are in."""
    if len({folder.resolve().parent for folder in folders}) > 1:
        names = ", ".join(map(str, folders))
        raise ValueError(f"studies: {names} are not beside each other; give --out")
    return folders[0].parent


def _word(study: str) -> str:
    """A study as it is named; an override is none."""
    if "=" in study:
        raise ValueError(f"{study!r} is not understood; it takes studies")
    return study


def _status(options: argparse.Namespace) -> None:
    from needlehoop.study.data.records import Study, read_study
    from needlehoop.study.data.sweeps import planned, read_job_ends
    from needlehoop.study.report.status import describe, standings

    expected = planned(options.overrides) if options.overrides else None
    ends, unread = read_job_ends(options.study)
    # Before its first run a planned study has no folder.
    begun = options.study.exists() or not (expected or ends)
    study = read_study(options.study) if begun else Study(options.study, (), ())
    study = replace(study, left_out=(*study.left_out, *unread))
    print(describe(standings(study, ends, expected), study))


def _top(options: argparse.Namespace) -> None:
    _no_more(options)
    findings, _ = _open(options.study, options.out)
    ranked = findings.ranked
    count = min(_TOP, len(ranked)) if options.count is None else options.count
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
        print(f"left out: {len(findings.left_out)}")
        for one in findings.left_out:
            print(f"  {one}")


def _no_more(options: argparse.Namespace) -> None:
    """These commands take no overrides."""
    if options.overrides:
        raise ValueError(f"{options.overrides[0]!r} is not understood; it takes one study")
