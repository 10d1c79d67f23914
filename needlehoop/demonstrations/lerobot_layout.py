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

_FILE = "chunk-000/file-000"
"""All of a dataset is in the first file of the first chunk, which the format allows."""

_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"


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
    rate, task, depths = frames_a_second(settings), settings.definition, spans(settings)
    films: dict[str, Callable[[np.ndarray], None]] = {}
    # All rows of all episodes, but few of their images: films are too large to keep.
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
            few = -(-len(episode) // SAMPLED)
            episode_columns = rows_of(episode, len(stories), begin, rate)
            episode_columns |= {key: images[::few] for key, images in seen.items()}
            for key, values in episode_columns.items():
                kept[key].append(values)
            stories.append(_story(task.summary, episode_columns, films, rate))
    columns = {key: np.concatenate(rows) for key, rows in kept.items()}
    plain = {key: rows for key, rows in columns.items() if key not in films}
    table = pa.table({key: column(rows) for key, rows in plain.items()})
    pq.write_table(table, _path(folder, "data", "parquet"))
    pq.write_table(pa.Table.from_pylist(stories), _path(folder, "meta/episodes", "parquet"))
    # The task's text is the index.
    tasks = pd.DataFrame({"task_index": [0]}, pd.Index([task.summary], name="task"))
    tasks.to_parquet(folder / "meta/tasks.parquet")
    info = {
        "codebase_version": "v3.0",
        **made_by(settings, demonstrator, provenance),
        "total_episodes": len(stories),
        "total_frames": stories[-1]["dataset_to_index"],
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(stories)}"},
        "data_path": f"data/{_PATTERN}.parquet",
        "video_path": f"videos/{{video_key}}/{_PATTERN}.mp4",
        "features": features(plain, {key: depths.get(key) for key in films}, settings, rate),
    }
    stats = {key: spread(rows) for key, rows in columns.items()}
    for name, content in (("stats", stats), ("info", info)):
        (folder / "meta" / f"{name}.json").write_text(json.dumps(content, indent=4) + "\n")


def _path(folder: Path, place: str, suffix: str) -> Path:
    path = folder / place / f"{_FILE}.{suffix}"
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


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
