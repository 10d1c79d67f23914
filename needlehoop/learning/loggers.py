"""Where a run is shown beside its own files: TensorBoard, Weights & Biases."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from needlehoop.learning.job import Job, WandbConfig

TENSORBOARD = "tensorboard"
"""The package, the logger's name, and the folder in a run's."""


class Logger:
    """Takes what the CSV files take, for each of several places; none: those files are enough."""

    def __init__(self, *places: TensorBoard | WeightsAndBiases):
        self._places = places

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        """A row of the table ``group``."""
        # Empty numbers have no place in a curve.
        curves = {f"{group}/{name}": value for name, value in row.items() if value == value}
        for one in self._places:
            one.log(curves, int(row["step"]))

    def video(self, path: Path) -> None:
        """The video of the finished run."""
        for one in self._places:
            one.video(path)

    def close(self) -> None:
        """The run is over, for whatever reason."""
        for one in self._places:
            one.close()


class TensorBoard:
    """Curves as TensorBoard's event files, in a folder of the run's.

    Args:
        steps: that the run begins with; later points of an interrupted training are taken back.
    """

    def __init__(self, folder: Path, steps: int):
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder / TENSORBOARD), purge_step=steps + 1)
        print(f"tensorboard: see it with: tensorboard --logdir {folder / TENSORBOARD}")

    def log(self, curves: dict[str, Any], step: int) -> None:
        for name, value in curves.items():
            self._writer.add_scalar(name, value, step)

    def video(self, path: Path) -> None:
        """Nothing: the file is in the run's folder."""

    def close(self) -> None:
        self._writer.close()


class WeightsAndBiases:
    """Curves and the video on Weights & Biases; offline where nobody is logged in.

    Args:
        run_name: the run's folder below the results; also its identity when resumed.
        folder: for wandb's own files.
    """

    def __init__(self, config: WandbConfig, run_name: str, values: Mapping[str, Any], folder: Path):
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
        if self._run.url:
            print(f"wandb: {self._run.url}")
        elif self._run.settings.mode == "offline":
            print(f"wandb: offline; send it with: wandb sync {Path(self._run.dir).parent}")

    def log(self, curves: dict[str, Any], step: int) -> None:
        self._run.log(curves, step=step)

    def video(self, path: Path) -> None:
        self._run.log({"video": self._wandb.Video(str(path), format="mp4")})

    def close(self) -> None:
        self._run.finish()


def build_logger(job: Job, values: Mapping[str, Any], folder: Path, steps: int) -> Logger:
    """What shows a run beside its own files.

    Args:
        steps: that it begins with.

    Raises:
        ValueError: as in ``check_installed``.
    """
    check_installed(job)
    places: list[Any] = []
    if TENSORBOARD in job.logger:
        places.append(TensorBoard(folder, steps))
    if "wandb" in job.logger:
        places.append(WeightsAndBiases(job.wandb, job.place, values, folder))
    return Logger(*places)


def check_installed(job: Job) -> None:
    """Raises ``ValueError`` if a job is to be shown by a package that is not there."""
    if TENSORBOARD in job.logger and find_spec(TENSORBOARD) is None:
        raise ValueError(
            f"logger: {TENSORBOARD} is not installed: pip install 'needlehoop[{TENSORBOARD}]'"
        )
