"""The pictures and films of a page: what each agent sees, and how much room films have."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from needlehoop.runs.reading import UnreadableError
from needlehoop.study.data import paper
from needlehoop.study.data.contents import check_media
from needlehoop.study.data.paper import reward_order
from needlehoop.study.data.records import Record, Study
from needlehoop.study.stats.findings import Result, StudyFindings

CAMERAS = "cameras"
"""A study's folder with what an agent sees through each camera; for the paper's task, beside it."""

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
    for _, results in rankings_by_reward(findings):
        order = sorted(range(len(results)), key=lambda i: min(i, len(results) - 1 - i))
        filmed = [filmed_run(results[number].runs) for number in order]
        found.append([run.video for run in filmed if run and run.video])
    return found


def filmed_run(runs: Sequence[Record]) -> Record | None:
    """The first run that has a film."""
    return next((run for run in runs if run.video is not None), None)


def tiles_of(study: Study | None) -> tuple[dict[str, str], list[str]]:
    """What agents see: addresses that hold whole images, by camera; and why some are missing."""
    found: dict[str, str] = {}
    problems = []
    for name, _, path in _pictures(study) if study else ():
        try:
            if path is None:
                problems.append(f"no picture of {name}")
            else:
                check_media(path)
                found[name] = inline(path)
        except UnreadableError as error:
            problems.append(f"{path} {error}; remove it, and it is drawn anew")
    return found, problems


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


def rankings_by_reward(findings: StudyFindings) -> list[tuple[str, list[Result]]]:
    """Rewards, the one under which cameras are compared first, with their results."""
    rewards = sorted(
        {result.reward for result in findings.results},
        key=lambda reward: (reward != findings.main_reward, reward_order(reward)),
    )
    return [(one, [r for r in findings.results if r.reward == one]) for one in rewards]
