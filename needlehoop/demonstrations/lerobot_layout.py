"""LeRobot's layout, version 3: parquet files, and one film per camera for all episodes.

Written from its public format, with pyarrow and pandas: lerobot itself wants other versions of
torch and wandb than we do. It is read by ``LeRobotDataset(repo_id, root=folder)``.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from needlehoop.demonstrations.episodes import Demonstration
from needlehoop.demonstrations.lerobot_films import description, film, spans, streams
from needlehoop.envs.settings import Settings
from needlehoop.scene.signals import sensors_of
from needlehoop.tasks.contract import Task
from needlehoop.tasks.psm import ROBOT as PSM

_FILE = "chunk-000/file-000"
"""All of a dataset is in the first file of the first chunk, which the format allows."""

_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"

_PSM_ACTIONS = {
    "tip": ("x", "y", "z", "turn", "jaw"),
    "pose": ("x", "y", "z", "turn_x", "turn_y", "turn_z", "jaw"),
}

_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""LeRobot's policies normalise by these, too."""

_SAMPLED = 8
"""Frames of an episode, at most, that statistics of its images are taken over."""


def write(
    folder: Path,
    episodes: Iterable[Demonstration],
    settings: Settings,
    demonstrator: str,
    provenance: Mapping[str, Any],
) -> None:
    """Write a dataset; a frame is what was seen, and the action that was then taken.

    A camera with depth gives two films, ``<camera>`` and ``<camera>_depth``. ``ValueError``: a rate
    or a size of images that the layout does not have.
    """
    exact, task = 1.0 / settings.period, settings.definition
    rate = round(exact)
    if rate != exact:
        raise ValueError(f"episode.substeps: {exact} steps a second; LeRobot wants whole ones")
    depths = spans(settings)
    films: dict[str, Callable[[np.ndarray], None]] = {}
    # Rows of all episodes, and of their images a few; films are too large to keep.
    kept: defaultdict[str, list[np.ndarray]] = defaultdict(list)
    stories: list[dict[str, Any]] = []
    with ExitStack() as open_films:
        for episode in episodes:
            seen = streams(episode, depths)
            for key, images in seen.items():
                if key not in films:
                    path = _path(folder, f"videos/{key}", "mp4")
                    begun = film(path, settings.image_size, rate, depths.get(key))
                    films[key] = open_films.enter_context(begun)
                films[key](images)
            begin = stories[-1]["dataset_to_index"] if stories else 0
            few = -(-len(episode) // _SAMPLED)
            own = _rows(episode, len(stories), begin, rate)
            own |= {key: images[::few] for key, images in seen.items()}
            for key, values in own.items():
                kept[key].append(values)
            stories.append(_story(task.summary, own, films, rate))
    columns = {key: np.concatenate(rows) for key, rows in kept.items()}
    plain = {key: _column(rows) for key, rows in columns.items() if key not in films}
    pq.write_table(pa.table(plain), _path(folder, "data", "parquet"))
    pq.write_table(pa.Table.from_pylist(stories), _path(folder, "meta/episodes", "parquet"))
    # The task's text is the index.
    tasks = pd.DataFrame({"task_index": [0]}, pd.Index([task.summary], name="task"))
    tasks.to_parquet(folder / "meta/tasks.parquet")
    features = {}
    for key in films:
        told = description(settings.image_size, rate, depths.get(key))
        names = ["height", "width", "channels"]
        shape = [told[f"video.{name}"] for name in names]
        features[key] = {"dtype": "video", "shape": shape, "names": names, "info": told}
    names = {"observation.state": proprio_names(task)}
    if task.robot is PSM:
        names["action"] = [*_PSM_ACTIONS[settings.episode.control]]
    for key in plain:
        rows = columns[key]
        shape = list(rows.shape[1:]) or [1]
        features[key] = {"dtype": str(rows.dtype), "shape": shape, "names": names.get(key)}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "dvrk_psm" if task.robot is PSM else task.robot.body,
        "total_episodes": len(stories),
        "total_frames": stories[-1]["dataset_to_index"],
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(stories)}"},
        "data_path": f"data/{_PATTERN}.parquet",
        "video_path": f"videos/{{video_key}}/{_PATTERN}.mp4",
        "features": features,
        "needlehoop": {
            "demonstrator": demonstrator,
            "cams": list(settings.cams),
            "seed": settings.seed,
            "provenance": dict(provenance),
        },
    }
    stats = {key: spread(rows) for key, rows in columns.items()}
    for name, content in (("stats", stats), ("info", info)):
        (folder / "meta" / f"{name}.json").write_text(json.dumps(content, indent=4) + "\n")


def _path(folder: Path, place: str, suffix: str) -> Path:
    path = folder / place / f"{_FILE}.{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _rows(episode: Demonstration, number: int, begin: int, rate: int) -> dict[str, np.ndarray]:
    """The columns of an episode's frames, the first of which is the dataset's ``begin``."""
    n = len(episode)
    last = np.arange(n) == n - 1
    seen = {f"observation.{name}": rows[:-1] for name, rows in episode.vectors.items()}
    return {
        "observation.state": seen.pop("observation.proprio"),
        **seen,
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": last,
        "next.success": last & episode.success,
        "timestamp": (np.arange(n) / rate).astype(np.float32),
        "frame_index": np.arange(n),
        "episode_index": np.full(n, number),
        "index": begin + np.arange(n),
        "task_index": np.zeros(n, dtype=np.int64),
    }


def _story(
    task: str, kept: dict[str, np.ndarray], films: Iterable[str], rate: int
) -> dict[str, Any]:
    """What the table of episodes says of one: where its frames are, and their statistics."""
    begin, end = int(kept["index"][0]), int(kept["index"][-1]) + 1
    row: dict[str, Any] = {
        "episode_index": int(kept["episode_index"][0]),
        "tasks": [task],
        "length": end - begin,
        "dataset_from_index": begin,
        "dataset_to_index": end,
    }
    for place in ("data", "meta/episodes", *(f"videos/{key}" for key in films)):
        row |= {f"{place}/chunk_index": 0, f"{place}/file_index": 0}
    for key in films:
        row[f"videos/{key}/from_timestamp"] = begin / rate
        row[f"videos/{key}/to_timestamp"] = end / rate
    for key, values in kept.items():
        row |= {f"stats/{key}/{name}": value for name, value in spread(values).items()}
    return row


def proprio_names(task: Task) -> list[str]:
    """Names of the numbers that a robot knows of itself: a sensor's, or its signal's."""
    names = []
    for signal in task.robot.proprio:
        own, size = [*sensors_of({signal: task.signals[signal]})], task.signals[signal].size
        numbered = [signal] if size == 1 else [f"{signal}_{i}" for i in range(size)]
        names += own if len(own) == size else numbered
    return names


def _column(values: np.ndarray) -> pa.Array:
    """A column of numbers, or of lists of one length."""
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def spread(values: np.ndarray) -> dict[str, Any]:
    """Statistics of rows ``(m,)`` or ``(m, k)``, or of images ``(m, h, w, c)``.

    Of rows lists of one or ``k`` numbers; of the images' pixels ``(c, 1, 1)``: colours, which are
    uint8, from 0 to 1, depth in its own unit.
    """
    rows, shape = values.astype(np.float64).reshape(len(values), -1), (-1,)
    if values.ndim == 4:
        rows, shape = rows.reshape(-1, values.shape[-1]), (-1, 1, 1)
        if values.dtype == np.uint8:
            rows = rows / 255.0
    found = {name: getattr(rows, name)(0) for name in ("min", "max", "mean", "std")}
    found |= {name: np.quantile(rows, share, axis=0) for name, share in _QUANTILES.items()}
    told = {name: row.reshape(shape).tolist() for name, row in found.items()}
    return {**told, "count": [len(values)]}
