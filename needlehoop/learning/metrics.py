"""The columns of ``metrics.csv``, and where else a run is shown."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase

from needlehoop.learning.job import LoggerConfig


def episode_columns(buffer: TensorDictBase, facts: Mapping[str, str]) -> dict[str, float]:
    """Means over the episodes that ended in a buffer ``(num_envs, horizon)``; NaN for none.

    The return is the final potential; ``length`` is in steps.

    Args:
        buffer: as a method of learning gives it.
        facts: to be reported, by column; ``Task.columns``.
    """
    following: Any = buffer["next"]
    last = following[following["done"].squeeze(-1)]
    columns = {
        "episodes": float(len(last)),
        "return": float(last["potential"].mean()),
        **{f"term_{name}": float(term.mean()) for name, term in last["terms"].items()},
    }
    for column, fact in facts.items():
        columns[column] = float(last["facts", fact].float().mean())
    columns["length"] = float(last["steps"].float().mean())
    return columns


def peak_memory() -> float:
    """The most memory this process has had, GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)


class Logger:
    """Takes what the CSV files take. This one does nothing: the run's own files are enough."""

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        """A row of the table ``group``."""

    def video(self, path: Path) -> None:
        """The video of the finished run."""

    def close(self) -> None:
        """The run is over, for whatever reason."""


class WeightsAndBiases(Logger):
    """Curves and the video on Weights & Biases; offline where nobody is logged in.

    Args:
        config: project, entity, mode.
        run_name: the run's folder below the results; also its identity when resumed.
        values: the composed config.
        folder: for wandb's own files.
    """

    def __init__(
        self, config: LoggerConfig, run_name: str, values: Mapping[str, Any], folder: Path
    ):
        import wandb

        mode: Any = config.mode
        if mode == "auto":
            mode = "online" if wandb.login(prompt=False, verify=False) else "offline"
        self._wandb = wandb
        wanted: dict[str, Any] = {
            "project": config.project,
            "entity": config.entity,
            "name": run_name,
            "config": dict(values),
            "dir": str(folder),
            "resume": "allow" if mode == "online" else None,
            "id": run_name.replace("/", "-").replace("+", "-") if mode == "online" else None,
        }
        try:
            settings = wandb.Settings(silent=True, init_timeout=30)
            self._run = wandb.init(mode=mode, settings=settings, **wanted)
        except (wandb.errors.CommError, wandb.errors.UsageError) as error:
            # The login is there but the service is not; the run must not wait for it.
            print(f"logger=wandb: {error}; going on offline")
            # Settings of its own: the first ones carry the failed run's id.
            wanted |= {"resume": None, "id": None, "settings": wandb.Settings(silent=True)}
            self._run = wandb.init(mode="offline", **wanted)

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        shown = {f"{group}/{name}": value for name, value in row.items() if value == value}
        self._run.log(shown, step=int(row["step"]))

    def video(self, path: Path) -> None:
        self._run.log({"video": self._wandb.Video(str(path), format="mp4")})

    def close(self) -> None:
        self._run.finish()


def build_logger(
    config: LoggerConfig, run_name: str, values: Mapping[str, Any], folder: Path
) -> Logger:
    """The logger of a run; arguments as in ``WeightsAndBiases``."""
    if config.kind == "csv":
        return Logger()
    return WeightsAndBiases(config, run_name, values, folder)
