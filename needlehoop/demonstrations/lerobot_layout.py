"""LeRobot's layout, version 3: parquet files, and one film per camera for all episodes.

Written from its public format, with pyarrow and the library that writes our films: lerobot
0.4.4 itself wants other versions of torch and wandb than we do. It is read by
``LeRobotDataset(repo_id, root=folder)``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from needlehoop.demonstrations.episodes import About, Demonstration
from needlehoop.scene.signals import sensors_of
from needlehoop.tasks.contract import Task
from needlehoop.tasks.psm import ROBOT as PSM

_VERSION = "v3.0"
_FILE = "chunk-000/file-000"
"""All of a dataset is in the first file of the first chunk, which the format allows."""

_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}"

_CODEC, _PIXELS = "h264", "yuv444p"
"""Colours at full resolution: halved, as is usual, a thing two pixels wide bleeds into black."""

_ENCODING = ["-crf", "12", "-g", "2", "-bf", "0"]
"""Near to lossless; every second frame can be jumped to; frames in the order of their times."""

_PSM_ACTIONS = {
    "tip": ("x", "y", "z", "turn", "jaw"),
    "pose": ("x", "y", "z", "turn_x", "turn_y", "turn_z", "jaw"),
}
"""By control mode."""

_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Among the statistics that LeRobot's policies normalise by."""

_SAMPLED = 8
"""Frames of an episode, at most, that statistics of its images are taken over."""


def write(folder: Path, episodes: Iterable[Demonstration], about: About) -> None:
    """Write a dataset; a frame is what was seen, and the action that was then taken.

    A camera with depth gives two films, ``<camera>`` and ``<camera>_depth`` (grey).
    """
    rate = round(about.rate)
    if rate != about.rate:
        raise ValueError(f"episode.substeps: {about.rate} steps a second; LeRobot wants whole ones")
    writer = _Writer(folder, rate, about)
    with ExitStack() as open_files:
        for episode in episodes:
            writer.add(episode, open_files)
    writer.close()


class _Writer:
    """A dataset under way; ``add`` episodes, then ``close``."""

    def __init__(self, folder: Path, rate: int, about: About):
        self._folder, self._rate, self._about = folder, rate, about
        self._task = about.settings.definition
        self._films: dict[str, Any] = {}
        self._frames: pq.ParquetWriter | None = None
        self._episodes: list[dict[str, Any]] = []
        self._kept: dict[str, list[np.ndarray]] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._total = 0

    def add(self, episode: Demonstration, open_files: ExitStack) -> None:
        streams = {f"observation.images.{name}": rows for name, rows in _streams(episode)}
        for key, images in streams.items():
            if key not in self._films:
                self._films[key] = open_files.enter_context(self._film(key))
                self._shapes[key] = images.shape[1:]
            for image in images:
                self._films[key].append_data(image)
        rows = self._rows(episode)
        table = pa.table({key: _column(values) for key, values in rows.items()})
        if self._frames is None:
            path = self._path("data", "parquet")
            self._frames = open_files.enter_context(pq.ParquetWriter(path, table.schema))
            self._shapes |= {key: values.shape[1:] or (1,) for key, values in rows.items()}
        self._frames.write_table(table)
        self._note(episode, rows, streams)

    def close(self) -> None:
        """Write what is known only now: episodes, task, statistics, and what it all is."""
        columns = {key: [row[key] for row in self._episodes] for key in self._episodes[0]}
        pq.write_table(pa.table(columns), self._path("meta/episodes", "parquet"))
        pq.write_table(_tasks(self._task.summary), self._folder / "meta/tasks.parquet")
        spread = {key: self._spread(key, np.concatenate(rows)) for key, rows in self._kept.items()}
        self._json("stats", spread)
        self._json("info", self._info())

    def _film(self, key: str) -> Any:
        return imageio.get_writer(
            self._path(f"videos/{key}", "mp4"),
            fps=self._rate,
            codec="libx264",
            pixelformat=_PIXELS,
            quality=None,
            output_params=_ENCODING,
            # Any size: nothing is scaled.
            macro_block_size=1,
        )

    def _rows(self, episode: Demonstration) -> dict[str, np.ndarray]:
        n = len(episode)
        last = np.arange(n) == n - 1
        return {
            "observation.state": episode.vectors["proprio"][:-1],
            **{
                f"observation.{name}": rows[:-1]
                for name, rows in episode.vectors.items()
                if name != "proprio"
            },
            "action": episode.actions,
            "next.reward": episode.rewards,
            "next.done": last,
            "next.success": last & episode.success,
            "timestamp": (np.arange(n) / self._rate).astype(np.float32),
            "frame_index": np.arange(n),
            "episode_index": np.full(n, len(self._episodes)),
            "index": self._total + np.arange(n),
            "task_index": np.zeros(n, dtype=np.int64),
        }

    def _note(
        self, episode: Demonstration, rows: dict[str, np.ndarray], streams: dict[str, np.ndarray]
    ) -> None:
        begin, end = self._total, self._total + len(episode)
        row: dict[str, Any] = {
            "episode_index": len(self._episodes),
            "tasks": [self._task.summary],
            "length": len(episode),
            "dataset_from_index": begin,
            "dataset_to_index": end,
        }
        for place in ("data", "meta/episodes", *(f"videos/{key}" for key in streams)):
            row |= {f"{place}/chunk_index": 0, f"{place}/file_index": 0}
        for key in streams:
            row[f"videos/{key}/from_timestamp"] = begin / self._rate
            row[f"videos/{key}/to_timestamp"] = end / self._rate
        step = -(-len(episode) // _SAMPLED)
        kept = {**rows, **{key: images[::step] for key, images in streams.items()}}
        for key, values in kept.items():
            self._kept.setdefault(key, []).append(values)
            row |= {f"stats/{key}/{name}": v for name, v in self._spread(key, values).items()}
        self._episodes.append(row)
        self._total = end

    def _spread(self, key: str, values: np.ndarray) -> dict[str, Any]:
        return of_images(values) if key in self._films else of_rows(values)

    def _info(self) -> dict[str, Any]:
        about, n = self._about, len(self._episodes)
        return {
            "codebase_version": _VERSION,
            "robot_type": "dvrk_psm" if self._task.robot is PSM else self._task.robot.body,
            "total_episodes": n,
            "total_frames": self._total,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._rate,
            "splits": {"train": f"0:{n}"},
            "data_path": f"data/{_PATTERN}.parquet",
            "video_path": f"videos/{{video_key}}/{_PATTERN}.mp4",
            "features": {key: self._feature(key, shape) for key, shape in self._shapes.items()},
            "needlehoop": {
                "demonstrator": about.demonstrator,
                "cams": list(about.settings.cams),
                "seed": about.settings.seed,
                "provenance": dict(about.provenance),
            },
        }

    def _feature(self, key: str, shape: tuple[int, ...]) -> dict[str, Any]:
        if key in self._films:
            height, width, channels = shape
            told = {
                "video.height": height,
                "video.width": width,
                "video.channels": channels,
                "video.codec": _CODEC,
                "video.pix_fmt": _PIXELS,
                "video.is_depth_map": False,
                "video.fps": self._rate,
                "has_audio": False,
            }
            names = ["height", "width", "channels"]
            return {"dtype": "video", "shape": list(shape), "names": names, "info": told}
        names = {
            "action": self._actions(),
            "observation.state": proprio_names(self._task),
        }
        dtype = str(self._kept[key][0].dtype)
        return {"dtype": dtype, "shape": list(shape), "names": names.get(key)}

    def _actions(self) -> tuple[str, ...] | None:
        """Names of an action's numbers, where they are known."""
        if self._task.robot is not PSM:
            return None
        return _PSM_ACTIONS.get(self._about.settings.episode.control)

    def _path(self, place: str, suffix: str) -> Path:
        path = self._folder / place / f"{_FILE}.{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _json(self, name: str, content: Any) -> None:
        (self._folder / "meta" / f"{name}.json").write_text(json.dumps(content, indent=4) + "\n")


def proprio_names(task: Task) -> list[str]:
    """Names of the numbers that a robot knows of itself: a sensor's, or its signal's."""
    names = []
    for signal in task.robot.proprio:
        own, size = [*sensors_of({signal: task.signals[signal]})], task.signals[signal].size
        numbered = [signal] if size == 1 else [f"{signal}_{i}" for i in range(size)]
        names += own if len(own) == size else numbered
    return names


def _streams(episode: Demonstration) -> Iterator[tuple[str, np.ndarray]]:
    """Films ``(t, h, w, 3)`` by name; what was seen after the last step is left out."""
    for name, images in episode.images.items():
        seen = images[:-1]
        if seen.shape[-1] == 1:
            yield name, seen.repeat(3, -1)
            continue
        yield name, seen[..., :3]
        if seen.shape[-1] == 4:
            yield f"{name}_depth", seen[..., 3:].repeat(3, -1)


def _column(values: np.ndarray) -> pa.Array:
    """A column of numbers, or of lists of one length."""
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def _tasks(summary: str) -> pa.Table:
    """The one task; its text is the index that pandas reads."""
    table = pa.table({"task_index": pa.array([0]), "task": [summary]})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": of, "metadata": None}
        for name, kind, of in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    told = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps(told)})


def of_rows(values: np.ndarray) -> dict[str, Any]:
    """Over the rows of ``values`` ``(m,)`` or ``(m, k)``: lists of one or ``k`` numbers."""
    return _statistics(values.reshape(len(values), -1).astype(np.float64), len(values), (-1,))


def of_images(images: np.ndarray) -> dict[str, Any]:
    """Over the pixels of ``images`` ``(m, h, w, c)`` uint8, 0 to 1: by channel, ``(c, 1, 1)``."""
    pixels = images.reshape(-1, images.shape[-1]) / 255.0
    return _statistics(pixels, len(images), (-1, 1, 1))


def _statistics(rows: np.ndarray, count: int, shape: tuple[int, ...]) -> dict[str, Any]:
    found = {
        "min": rows.min(0),
        "max": rows.max(0),
        "mean": rows.mean(0),
        "std": rows.std(0),
        **{name: np.quantile(rows, share, axis=0) for name, share in _QUANTILES.items()},
    }
    return {**{name: row.reshape(shape).tolist() for name, row in found.items()}, "count": [count]}
