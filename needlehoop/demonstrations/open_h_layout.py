"""The layout that Open-H-Embodiment takes: LeRobot's version 2.1, with fields for surgery.

A parquet file and a film per camera for each episode. Written from the guide and the validator of
github.com/open-h/open-h-embodiment (commit c64ed5e). lerobot 0.3.3 reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from needlehoop.demonstrations.episodes import PERTURBED, Demonstration
from needlehoop.demonstrations.lerobot_films import film, spans, streams
from needlehoop.demonstrations.lerobot_rows import (
    SAMPLED,
    column,
    features,
    frames_a_second,
    made_by,
    rows_of,
    spread,
)
from needlehoop.envs.settings import Settings
from needlehoop.scene.image_size import ImageSize, sides

_CHUNK = 1000
"""Episodes in a folder."""

_WAITING = "waiting"
"""Films wait here until all episodes are flown: failures are numbered last."""

_DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
_FILM = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"


_Kept = tuple[Demonstration, dict[str, Path], dict[str, Any]]
"""An episode without its images, and its films and their statistics by key."""


def write(
    folder: Path,
    episodes: Iterable[Demonstration],
    settings: Settings,
    demonstrator: str,
    provenance: Mapping[str, Any],
) -> None:
    """Write a dataset: first the episodes that succeed, then the ``failure`` ones.

    Those that succeed are ``train``; of ``PERTURBED``, which errs and corrects itself,
    ``recovery``. ``ValueError`` for a rate that is not whole, or a camera with depth.
    """
    rate = frames_a_second(settings)
    if depths := spans(settings):
        cameras = ", ".join(key.split(".")[-1].removesuffix("_depth") for key in depths)
        raise ValueError(f"cams: {cameras}; format=open_h has no depth: choose rgb, seg or segdep")
    kept: list[_Kept] = []
    for episode in episodes:
        kept.append(_filmed(folder, episode, len(kept), settings.image_size, rate))
    kept.sort(key=lambda entry: not entry[0].success)
    task, frames, stories, stats = settings.definition, 0, [], []
    texts = {"instruction.text": task.summary, "observation.meta.tool": task.robot.tool}
    columns: dict[str, np.ndarray] = {}
    for number, (episode, films, film_stats) in enumerate(kept):
        n, numbers = len(episode), rows_of(episode, number, frames, rate)
        columns = numbers | {key: np.full(n, text) for key, text in texts.items() if text}
        frames += n
        place = {"episode_chunk": number // _CHUNK, "episode_index": number}
        table = pa.table({key: column(rows) for key, rows in columns.items()})
        pq.write_table(table, _made(folder / _DATA.format(**place)))
        for key, filmed in films.items():
            filmed.rename(_made(folder / _FILM.format(video_key=key, **place)))
        stories.append({"episode_index": number, "tasks": [task.summary], "length": n})
        spreads = film_stats | {key: spread(rows) for key, rows in numbers.items()}
        stats.append({"episode_index": number, "stats": spreads})
    (folder / _WAITING).rmdir()
    films, total, good = kept[0][1], len(kept), sum(episode.success for episode, _, _ in kept)
    succeeded = "recovery" if demonstrator == PERTURBED else "train"
    splits = {succeeded: (0, good), "failure": (good, total)}
    info = {
        "codebase_version": "v2.1",
        **made_by(settings, demonstrator, provenance),
        "total_episodes": total,
        "total_frames": frames,
        "total_videos": total * len(films),
        "total_chunks": -(-total // _CHUNK),
        "chunks_size": _CHUNK,
        "fps": rate,
        "splits": {name: f"{a}:{b}" for name, (a, b) in splits.items() if a < b},
        "data_path": _DATA,
        "video_path": _FILM,
        "features": features(columns, dict.fromkeys(films), settings, rate),
    }
    meta = _made(folder / "meta" / "info.json").parent
    (meta / "info.json").write_text(json.dumps(info, indent=4) + "\n")
    tasks = [{"task_index": 0, "task": task.summary}]
    for name, lines in (("tasks", tasks), ("episodes", stories), ("episodes_stats", stats)):
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (meta / f"{name}.jsonl").write_text(text)
    (meta / "README.md").write_text(_readme(info, settings, demonstrator))


def _filmed(folder: Path, episode: Demonstration, number: int, size: ImageSize, rate: int) -> _Kept:
    films, stats = {}, {}
    for key, images in streams(episode, {}).items():
        films[key] = _made(folder / _WAITING / f"{number}_{key}.mp4")
        with film(films[key], size, rate, None) as add:
            add(images)
        stats[key] = spread(images[:: -(-len(episode) // SAMPLED)])
    # Images of all episodes are too large to keep.
    return replace(episode, images={}), films, stats


def _made(path: Path) -> Path:
    """A path whose folder exists."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _readme(info: Mapping[str, Any], settings: Settings, demonstrator: str) -> str:
    """Open-H's page on a dataset, as far as we can fill it."""
    named = {key: feature for key, feature in info["features"].items() if feature["names"]}
    cameras = [key for key, feature in named.items() if feature["dtype"] == "video"]
    task, (width, height) = settings.definition, sides(settings.image_size)
    words = task.telling.values(settings.task, settings.episode) if task.telling else {}
    values = {
        "summary": task.summary,
        "episodes": info["total_episodes"],
        "hours": f"{info['total_frames'] / info['fps'] / 3600:.2f}",
        "splits": ", ".join(f"`{name}` {span}" for name, span in info["splits"].items()),
        "demonstrator": demonstrator,
        "cameras": "\n".join(f"- `{key}`: {width} x {height} px" for key in cameras),
        "robot": info["robot_type"],
        "tool": task.robot.tool or "none",
        "rate": info["fps"],
        "action": ", ".join(named["action"]["names"]) if "action" in named else "TO FILL",
        "control": words.get("control", "moves the robot: TO FILL"),
        "state": ", ".join(named["observation.state"]["names"]),
    }
    return Template((Path(__file__).parent / "open_h_readme.txt").read_text()).substitute(values)
