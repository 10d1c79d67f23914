"""The ranking as a gallery: what each agent sees, how far it comes, and its film."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from needlehoop.runs.reading import UnreadableError
from needlehoop.study.data import paper
from needlehoop.study.data.contents import check_picture
from needlehoop.study.data.paper import reward_label, reward_order
from needlehoop.study.data.records import Record, Study
from needlehoop.study.render.table import Column
from needlehoop.study.report.tables import reached
from needlehoop.study.stats.findings import Result, StudyFindings
from needlehoop.study.stats.statistics import OVER_EPISODES

CAMERAS = "cameras"
"""A study's folder with what an agent sees through each camera; for the paper's task, beside it."""

_RETURN = Column("return", form=".2f")

_FILM = 4_000_000
"""Bytes of the longest film that is part of a page; a longer one is linked to."""

_TYPES = {".svg": "image/svg+xml", ".png": "image/png", ".mp4": "video/mp4"}


def inline(path: Path) -> str:
    """A file as an address that holds it."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_TYPES[path.suffix]};base64,{data}"


@dataclass(frozen=True)
class Films:
    """Films of a page."""

    folder: Path
    """Of the page, which links start from."""
    embedded: frozenset[Path] = frozenset()
    """Films inside the page; it links to the others."""

    def shown(self, film: Path) -> dict[str, Any]:
        """How the page shows a film."""
        embedded = film in self.embedded
        link = Path(os.path.relpath(film, self.folder)).as_posix()
        return {"embedded": embedded, "source": inline(film) if embedded else link}


def fitting(rankings: Sequence[Sequence[Path]], room: int) -> frozenset[Path]:
    """The films that fit into a page.

    Args:
        rankings: the films of each ranking, the most wanted first. Rankings take turns.
        room: bytes left in the page; base64 turns 3 bytes of a film into 4.
    """
    chosen = set()
    for turn in zip_longest(*rankings):
        for film in turn:
            size = film.stat().st_size if film else 0
            taken = 4 * -(-size // 3)
            if film and size <= _FILM and taken <= room:
                chosen.add(film)
                room -= taken
    return frozenset(chosen)


def films_of(findings: StudyFindings) -> list[list[Path]]:
    """The films of each ranking: the best and the worst first, the middle last."""
    found = []
    for _, results in _rankings(findings):
        order = sorted(range(len(results)), key=lambda i: min(i, len(results) - 1 - i))
        films = [_film(results[number]) for number in order]
        found.append([film for film in films if film])
    return found


@dataclass(frozen=True)
class Tiles:
    """What an agent sees through each camera."""

    images: Mapping[str, str]
    """Addresses that hold them, by camera."""
    problems: tuple[str, ...]
    """Why some are missing."""


def read_tiles(study: Study) -> Tiles:
    """The whole images of a study's cameras."""
    found: dict[str, str] = {}
    problems = []
    for name, _, path in _pictures(study):
        try:
            if path is None:
                problems.append(f"no picture of {name}")
            else:
                check_picture(path)
                found[name] = inline(path)
        except UnreadableError as error:
            problems.append(f"{path} {error}; remove it, and it is drawn anew")
    return Tiles(found, tuple(problems))


def undrawn(study: Study) -> dict[Path, list[str]]:
    """Cameras without a picture, by the folder of a run that can draw them."""
    found: dict[Path, list[str]] = {}
    for name, run, path in _pictures(study):
        if path is None:
            found.setdefault(run.folder, []).append(name)
    return found


def _pictures(study: Study) -> list[tuple[str, Record, Path | None]]:
    """Each camera of a study, the first run that has it, and its picture if there is one."""
    first: dict[str, Record] = {}
    for run in study.runs:
        for name in run.config["cams"]:
            first.setdefault(name, run)
    home = study.folder.resolve()
    places = [home, home.parent] if study.is_of(paper.task()) else [home]
    found = []
    for name, run in sorted(first.items()):
        paths = (place / CAMERAS / f"{name}.png" for place in places)
        found.append((name, run, next((path for path in paths if path.exists()), None)))
    return found


def galleries(findings: StudyFindings, films: Films, tiles: Tiles) -> list[dict[str, Any]]:
    """A ranking for each reward, the one under which cameras are compared first.

    Args:
        findings: of a study, or of the paper.
        films: how the page shows them.
        tiles: what the cameras see.
    """
    return [
        {"reward": reward_label(reward), "rows": _rows(findings, results, films, tiles.images)}
        for reward, results in _rankings(findings)
    ]


def _rankings(findings: StudyFindings) -> list[tuple[str, list[Result]]]:
    rewards = sorted(
        {result.reward for result in findings.results},
        key=lambda reward: (reward != findings.main_reward, reward_order(reward)),
    )
    return [(one, [r for r in findings.results if r.reward == one]) for one in rewards]


def _film(result: Result) -> Path | None:
    """Of the first seed that has one."""
    return next((run.video for run in result.runs if run.video is not None), None)


def _rows(
    findings: StudyFindings, results: Sequence[Result], films: Films, images: Mapping[str, str]
) -> list[dict[str, Any]]:
    phases = reached(findings)
    rows = []
    for number, result in enumerate(results):
        film = _film(result)
        phase = phases.get((result.cameras, result.reward))
        rows.append(
            {
                "place": number + 1,
                "cameras": result.cameras,
                "tiles": [
                    {"name": name, "image": images[name]}
                    for name in result.cameras.split("+")
                    if name in images
                ],
                "return": f"{result.value.value:.2f}",
                "interval": _RETURN.text(result.value.interval_or_why),
                "success": _success(result),
                "fails_in": phase.fails_in if phase else None,
                "film": films.shown(film) if film else None,
                "film_of": next((f"seed {r.place.seed}" for r in result.runs if r.video), ""),
                "unfinished": result.unfinished,
            }
        )
    return rows


def _success(result: Result) -> dict[str, Any] | None:
    """Percentages, for a bar and beside it."""
    found = result.success
    if found is None:
        return None
    seeds = "1 seed" if found.seeds == 1 else f"{found.seeds} seeds"
    low, high = (
        (100.0 * found.interval.low, 100.0 * found.interval.high) if found.interval else (0.0, 0.0)
    )
    over = f"{low:.0f} to {high:.0f} %; "
    if found.interval and found.interval.over == OVER_EPISODES:
        over += "over the episodes of "
    return {
        "share": f"{100.0 * found.value:.1f}",
        "low": f"{low:.1f}",
        "width": f"{high - low:.1f}",
        "said": f"{100.0 * found.value:.0f} %",
        "interval": f"{over if found.interval else ''}{seeds}",
    }
