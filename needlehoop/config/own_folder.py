"""Config folders of one's own, beside ``conf/``: ``conf_dir=<folder>``, and ``conf`` of a task.

A task from elsewhere is a folder (``task_dir=<folder>``) or an entry point of an installed package
(``task=<its name>``). Nothing of it is imported here.

Others may have written the YAML. Hydra reads a file when it is chosen, and only within limits.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.sources_registry import SourcesRegistry
from hydra.plugins.config_source import ConfigResult

from needlehoop.config.options import options, read_option, typed, views_apart
from needlehoop.runs.shipped import CONF

KEY, TASK_KEY = "conf_dir", "task_dir"

GROUP = "needlehoop.tasks"
"""Entry points of installed packages: ``mine = "my_package.my_task:TASK"``."""


class BoundedSource(FileConfigSource):
    """Hydra's folder of YAML files, each of which is checked before Hydra opens it."""

    @staticmethod
    def scheme() -> str:
        """What stands before ``://`` in Hydra's search path."""
        return "bounded"

    def load_config(self, config_path: str) -> ConfigResult:
        """Raises ``ValueError`` for a file that is no small mapping in YAML; names it."""
        file = Path(self.path) / self._normalize_file_name(config_path)
        # It is imported, and a file must not decide that.
        if file.exists() and TASK_KEY in read_option(file):
            raise ValueError(f"{file}: {TASK_KEY} counts only where you type it")
        return super().load_config(config_path)

    def is_config(self, config_path: str) -> bool:
        """Also of a pipe or a device, for ``load_config`` to name."""
        return (Path(self.path) / self._normalize_file_name(config_path)).exists()


def part(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the config folders that it named.

    ``conf_dir=`` is taken out. ``task_dir=`` becomes a whole path, and chooses its only task if no
    task is named.

    Raises:
        ValueError: one that is no config folder, or has a name that is taken; several tasks and
            none named.
    """
    given = list(words)
    folders = [Path(path).expanduser().resolve() for path in typed(given, KEY)]
    for folder in folders:
        _check(folder, KEY)
    rest = [word for word in given if not word.startswith(f"{KEY}=")]
    chosen, task = task_folder(rest), typed(rest, "task")
    if chosen is not None:
        _check(chosen / "conf", TASK_KEY)
        rest = [word for word in rest if not word.startswith(f"{TASK_KEY}=")]
        rest += [f"{TASK_KEY}={in_quotes(str(chosen))}"]
        rest += [] if task else [f"task={_only_task(chosen)}"]
        folders.append(chosen / "conf")
    elif task:
        folders += _installed(task[-1], [CONF, *folders])
    return rest, folders


def task_folder(words: Iterable[str]) -> Path | None:
    """The folder that ``task_dir=`` names, if it does; of several the last."""
    named = typed(words, TASK_KEY)
    if not named or named[-1] in ("", "null"):
        return None
    plain = re.sub(r"^(['\"])(.*)\1$", r"\2", named[-1])
    return Path(plain).expanduser().resolve()


def search_path(folders: Iterable[Path]) -> list[str]:
    """Hydra's override that has it look into the folders; none for none."""
    SourcesRegistry.instance().register(BoundedSource)
    places = ",".join(repr(f"{BoundedSource.scheme()}://{folder}") for folder in folders)
    return [f"hydra.searchpath=[{places}]"] if places else []


def in_quotes(path: str) -> str:
    """A path in quotes for Hydra, which takes ``=`` and ``{}`` for its own."""
    escaped = re.sub(r"(\\*)'", lambda found: 2 * found[1] + "\\'", path)
    trailing = len(path) - len(path.rstrip("\\"))
    return f"'{escaped}{trailing * chr(92)}'"


def _only_task(folder: Path) -> str:
    options = sorted(file.stem for file in (folder / "conf/task").glob("*.yaml"))
    if len(options) != 1:
        found = f"choose from {', '.join(options)}" if options else "there is no conf/task/*.yaml"
        raise ValueError(f"{TASK_KEY}: {str(folder)!r}: which task=? {found}")
    return options[0]


def _installed(option: str, folders: Sequence[Path]) -> list[Path]:
    """The config folder of an installed package's task; none for an option that is a file."""
    if any((folder / "task" / f"{option}.yaml").is_file() for folder in folders):
        return []
    found = []
    for entry in entry_points(group=GROUP, name=option.partition("/")[0]):
        spec = find_spec(entry.module)
        if spec is not None and spec.origin is not None:
            found.append(Path(spec.origin).parent / "conf")
            _check(found[-1], f"the entry point {entry.name}")
    return found


def _check(folder: Path, key: str) -> None:
    """Raises ``ValueError`` for a folder or file that Hydra would silently ignore."""
    # Not Path.is_dir, which raises where a name is too long for the disk.
    if not os.path.isdir(folder):
        raise ValueError(f"{key}: {str(folder)!r} is no folder")
    valid = sorted(one.name for one in CONF.iterdir() if one.is_dir())
    for group in sorted(one.name for one in folder.iterdir() if one.is_dir()):
        if group not in valid:
            raise ValueError(f"{key}: {group!r} is no group; choose from {', '.join(valid)}")
        ours = {*_files(CONF / group), *options(CONF, group)}
        ours |= {*views_apart([CONF])} if group == "view" else set()
        for name in sorted({*_files(folder / group)} & ours):
            raise ValueError(f"{key}: {group}/{name}.yaml: the name is taken; choose another")


def _files(folder: Path) -> list[str]:
    return [str(file.relative_to(folder).with_suffix("")) for file in folder.rglob("*.yaml")]
