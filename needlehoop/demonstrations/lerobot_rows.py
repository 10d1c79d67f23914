"""What all versions of LeRobot's layout share: columns, their statistics, their descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from needlehoop.demonstrations.episodes import Demonstration
from needlehoop.demonstrations.lerobot_films import Span, description
from needlehoop.envs.settings import Settings
from needlehoop.scene.signals import sensors_of
from needlehoop.tasks.contract import Task

_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""LeRobot's policies normalise by these, too."""

SAMPLED = 8
"""Frames of an episode, at most, that statistics of its images are taken over."""


def frames_a_second(settings: Settings) -> int:
    """``ValueError`` where they are not whole."""
    exact = 1.0 / settings.period
    if round(exact) != exact:
        raise ValueError(f"episode.substeps: {exact} steps a second; LeRobot wants whole ones")
    return round(exact)


def rows_of(episode: Demonstration, number: int, begin: int, rate: int) -> dict[str, np.ndarray]:
    """The columns of an episode's frames; ``begin``: the first one's number in the dataset."""
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


def column(values: np.ndarray) -> pa.Array:
    """A column of numbers or texts, or of lists of one length."""
    if values.ndim == 1:
        return pa.array(values)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def features(
    columns: Mapping[str, np.ndarray],
    films: Mapping[str, Span | None],
    settings: Settings,
    rate: int,
) -> dict[str, Any]:
    """What ``meta/info.json`` says of each film, by its depths, and of each column."""
    entries: dict[str, Any] = {}
    for key, span in films.items():
        info = description(settings.image_size, rate, span)
        names = ["height", "width", "channels"]
        shape = [info[f"video.{name}"] for name in names]
        entries[key] = {"dtype": "video", "shape": shape, "names": names, "info": info}
    task = settings.definition
    names = {"observation.state": proprio_names(task)}
    if action := task.robot.actions.get(settings.episode.control):
        names["action"] = [*action]
    for key, rows in columns.items():
        dtype = "string" if rows.dtype.kind == "U" else str(rows.dtype)
        shape = list(rows.shape[1:]) or [1]
        entries[key] = {"dtype": dtype, "shape": shape, "names": names.get(key)}
    return entries


def made_by(settings: Settings, demonstrator: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """What ``meta/info.json`` says of the robot, and of how the episodes were made."""
    robot = settings.definition.robot
    origin = {"demonstrator": demonstrator, "cams": [*settings.cams], "seed": settings.seed}
    return {
        "robot_type": robot.label or robot.body,
        "total_tasks": 1,
        "needlehoop": {**origin, "provenance": {**provenance}},
    }


def proprio_names(task: Task) -> list[str]:
    """Names of the numbers that a robot knows of itself: a sensor's, or its signal's."""
    names = []
    for signal in task.robot.proprio:
        sensors, size = [*sensors_of({signal: task.signals[signal]})], task.signals[signal].size
        numbered = [signal] if size == 1 else [f"{signal}_{i}" for i in range(size)]
        names += sensors if len(sensors) == size else numbered
    return names


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
    statistics = {name: getattr(rows, name)(0) for name in ("min", "max", "mean", "std")}
    statistics |= {name: np.quantile(rows, share, axis=0) for name, share in _QUANTILES.items()}
    lists = {name: row.reshape(shape).tolist() for name, row in statistics.items()}
    return {**lists, "count": [len(values)]}
