"""Where a run is shown beside its own files: TensorBoard, Weights & Biases."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from needlehoop.learning.job import Job
from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import import_extra


class Logger:
    """Shows the rows of the CSV files elsewhere, if anywhere.

    ``steps``: that it begins with; TensorBoard drops later points of an interrupted training.
    Raises ``ValueError`` where TensorBoard is asked for and not installed.
    """

    def __init__(self, job: Job, values: Mapping[str, Any], folder: Path, steps: int):
        self._board: Any = None
        if "tensorboard" in job.logger:
            board = import_extra("torch.utils.tensorboard", "logger=tensorboard", "tensorboard")
            place = folder / "tensorboard"
            self._board = board.SummaryWriter(str(place), purge_step=steps + 1)
            print(f"tensorboard: see it with: tensorboard --logdir {place}")
        self._run: Any = _wandb_run(job, values, folder) if "wandb" in job.logger else None

    def log(self, group: str, row: Mapping[str, Any]) -> None:
        """A row of the table ``group``; a NaN is left out."""
        curves = {f"{group}/{name}": value for name, value in row.items() if value == value}
        step = int(row["step"])
        if self._board is not None:
            for name, value in curves.items():
                self._board.add_scalar(name, value, step)
        if self._run is not None:
            self._run.log(curves, step=step)

    def video(self, path: Path) -> None:
        """Show the video of the finished run at wandb."""
        if self._run is not None:
            import wandb

            self._run.log({"video": wandb.Video(str(path), format="mp4")})

    def close(self) -> None:
        """The run is over, for whatever reason."""
        if self._board is not None:
            self._board.close()
        if self._run is not None:
            self._run.finish()


def _wandb_run(job: Job, values: Mapping[str, Any], folder: Path) -> Any:
    """A run on Weights & Biases; offline where there is no login or no service."""
    import wandb

    mode: Any = job.wandb.mode
    if mode == "auto":
        mode = "online" if wandb.login(prompt=False, verify=False) else "offline"
    known = folder / "wandb_id.txt"
    options: dict[str, Any] = {
        "project": job.wandb.project,
        "entity": job.wandb.entity,
        "name": job.place,
        "config": dict(values),
        "dir": str(folder),
        "id": known.read_text() if known.exists() else None,
        "resume": "allow",
    }
    try:
        settings = wandb.Settings(silent=True, init_timeout=30)
        run = wandb.init(mode=mode, settings=settings, **options)
    except (wandb.errors.CommError, wandb.errors.UsageError) as error:
        print(f"logger=wandb: {error}; going on offline")
        run = wandb.init(mode="offline", settings=wandb.Settings(silent=True), **options)
    write_whole(known, run.id)
    if run.url:
        print(f"wandb: {run.url}")
    elif run.settings.mode == "offline":
        print(f"wandb: offline; send it with: wandb sync {folder / 'wandb'}/offline-run-*")
    return run
