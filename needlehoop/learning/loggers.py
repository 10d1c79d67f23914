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
    """Takes what the CSV files take. This one does nothing: the run's own files are enough."""

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        """A row of the table ``group``."""

    def video(self, path: Path) -> None:
        """The video of the finished run."""

    def close(self) -> None:
        """The run is over, for whatever reason."""


class TensorBoard(Logger):
    """Curves as TensorBoard's event files, in a folder of the run's.

    Args:
        folder: of the run.
        steps: that the run begins with; later points of an interrupted training are taken back.
    """

    def __init__(self, folder: Path, steps: int):
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder / TENSORBOARD), purge_step=steps + 1)
        print(f"tensorboard: see it with: tensorboard --logdir {folder / TENSORBOARD}")

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        for name, value in _curves(group, row).items():
            self._writer.add_scalar(name, value, int(row["step"]))

    def close(self) -> None:
        self._writer.close()


class WeightsAndBiases(Logger):
    """Curves and the video on Weights & Biases; offline where nobody is logged in.

    Args:
        config: project, entity, mode.
        run_name: the run's folder below the results; also its identity when resumed.
        values: the composed config.
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

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        self._run.log(_curves(group, row), step=int(row["step"]))

    def video(self, path: Path) -> None:
        self._run.log({"video": self._wandb.Video(str(path), format="mp4")})

    def close(self) -> None:
        self._run.finish()


class Several(Logger):
    """All of some loggers."""

    def __init__(self, *loggers: Logger):
        self._loggers = loggers

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        for one in self._loggers:
            one.log(group, row)

    def video(self, path: Path) -> None:
        for one in self._loggers:
            one.video(path)

    def close(self) -> None:
        for one in self._loggers:
            one.close()


def build_logger(job: Job, values: Mapping[str, Any], folder: Path, steps: int) -> Logger:
    """What shows a run beside its own files.

    Args:
        job: of the run.
        values: its composed config.
        folder: of the run.
        steps: that it begins with.

    Raises:
        ValueError: as in ``check_installed``.
    """
    check_installed(job)
    loggers: list[Logger] = []
    if TENSORBOARD in job.logger:
        loggers.append(TensorBoard(folder, steps))
    if "wandb" in job.logger:
        loggers.append(WeightsAndBiases(job.wandb, job.place, values, folder))
    return Several(*loggers)


def check_installed(job: Job) -> None:
    """Raises ``ValueError`` if a job is to be shown by a package that is not there."""
    if TENSORBOARD in job.logger and find_spec(TENSORBOARD) is None:
        raise ValueError(
            f"logger: {TENSORBOARD} is not installed: pip install 'needlehoop[{TENSORBOARD}]'"
        )


def _curves(group: str, row: Mapping[str, Any]) -> dict[str, Any]:
    """A row's numbers by their names in plots, without empty ones."""
    return {f"{group}/{name}": value for name, value in row.items() if value == value}
