"""Options of Hydra beyond the files of ``conf/``.

- Cameras: ``dep_front`` is the view ``front`` in the rendering ``dep``.
- What follows from the task: ``episode=default`` and ``reward=human`` are
  ``conf/episode/<task>.yaml`` and ``conf/reward/human/<task>.yaml``.
- Config folders of one's own: ``conf_dir=<folder>``, and ``conf`` of a task from elsewhere, which
  is a folder (``task_dir=<folder>``) or an entry point of an installed package
  (``task=<its name>``). Nothing of a task is imported here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore

from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF

CAMERAS = "cameras"
"""The key of the chosen cameras in a composed config."""

TASKS = "needlehoop.tasks"
"""Entry points of installed packages: ``mine = "my_package.my_task:TASK"``."""

_OF_TASK = {"episode": ("default", "episode"), "reward": ("human", "reward/human")}
"""By group: the option that follows from the task, and the folder of its files."""


def typed(words: Iterable[str], key: str) -> list[str]:
    """The values that a command line gives a key, as they were typed."""
    pairs = (word.lstrip("+").partition("=") for word in words)
    return [value for name, separator, value in pairs if separator and name == key]


def part(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the config folders of one's own that it named.

    ``conf_dir=`` is taken out. ``task_dir=`` becomes a whole path, and chooses its only task if no
    task is named. Raises ``ValueError`` for one that is no config folder, or has a taken name.
    """
    overrides = list(words)
    folders = [Path(path).expanduser().resolve() for path in typed(overrides, "conf_dir")]
    for folder in folders:
        _check(folder, "conf_dir")
    rest = [word for word in overrides if not word.startswith("conf_dir=")]
    task, chosen = typed(rest, "task"), ["", *typed(rest, "task_dir")][-1].strip("'\"")
    if chosen not in ("", "null"):
        place = Path(chosen).expanduser().resolve()
        _check(place / "conf", "task_dir")
        rest = [word for word in rest if not word.startswith("task_dir=")]
        rest += [f"task_dir={in_quotes(str(place))}"]
        rest += [] if task else [f"task={_only_task(place)}"]
        folders.append(place / "conf")
    elif task:
        folders += _installed(task[-1], [CONF, *folders])
    return rest, folders


def in_quotes(path: str) -> str:
    """A path in quotes for Hydra, which takes ``=`` and ``{}`` for its own."""
    return "'" + path.replace("'", "\\'") + "'"


def _only_task(folder: Path) -> str:
    options = names([folder / "conf"], "task")
    if len(options) != 1:
        valid = ", ".join(options) or "none, for there is no conf/task/*.yaml"
        raise ValueError(f"task_dir: {str(folder)!r}: which task=? choose from {valid}")
    return options[0]


def _installed(option: str, folders: Sequence[Path]) -> list[Path]:
    """The config folder of an installed package's task; none for an option that is a file."""
    if _files(folders, f"task/{option}.yaml"):
        return []
    entries = entry_points(group=TASKS, name=option.partition("/")[0])
    specs = [find_spec(entry.module) for entry in entries]
    found = [Path(spec.origin).parent / "conf" for spec in specs if spec and spec.origin]
    for folder in found:
        _check(folder, f"the entry point {option}")
    return found


def _check(folder: Path, key: str) -> None:
    """Raises ``ValueError`` for a folder or file that Hydra would silently ignore."""
    if not folder.is_dir():
        raise ValueError(f"{key}: {str(folder)!r} is no folder")
    groups = sorted(path.name for path in CONF.iterdir() if path.is_dir())
    for file in folder.rglob("*.yaml"):
        # That folder is imported, and a file must not decide it.
        if "task_dir" in read_yaml(file):
            raise ValueError(f"{file}: task_dir counts only where you type it")
        option = file.relative_to(folder)
        group = option.parts[0]
        if group not in groups:
            raise ValueError(f"{key}: {group!r} is no group; choose from {', '.join(groups)}")
        # A view is known by its name alone, whatever folder its file is in.
        namesakes = list(CONF.glob(f"view/**/{file.name}" if group == "view" else str(option)))
        if namesakes or option.with_suffix("").parts[1:] == _OF_TASK.get(group, ())[:1]:
            raise ValueError(f"{key}: {option}: the name is taken; choose another")


def register(words: Iterable[str], folders: Sequence[Path], task: str | None = None) -> None:
    """Tell Hydra of the options that a command line may choose; the first of ``folders`` is ours.

    A run decides its ``task``. Raises ``ValueError`` for a sweep over several tasks.
    """
    overrides = list(words)
    _register_cameras(overrides, folders)
    chosen = ["standard", *typed(overrides, "task")][-1].strip("'\"").split(",")
    tasks = {task} if task else {_task_of(option, folders) for option in chosen}
    if len(tasks) > 1:
        raise ValueError(f"task: a sweep is over one task's variants, not {', '.join(tasks)}")
    (name,) = tasks
    for group, (option, place) in _OF_TASK.items():
        for file in _files(folders, f"{place}/{name}.yaml")[:1]:
            ConfigStore.instance().store(group=group, name=option, node=read_yaml(file))


def _register_cameras(words: Sequence[str], folders: Sequence[Path]) -> None:
    """Every pair of a view and a rendering is an option of the group ``cams``.

    A config has every view and rendering. A view in a folder below ``view`` is there only if a word
    names it. An experiment may have ``views`` of its own.
    """
    store = ConfigStore.instance()
    views, renderings = (names(folders, group) for group in ("view", "rendering"))
    apart = {file.stem: file for file in _files(folders, "view/*/*.yaml")}
    line = " ".join(words)
    seen = {name for name in apart if re.search(rf"[._]{re.escape(name)}\b", line)}
    defaults = [{f"view@views.{name}": name} for name in views]
    defaults += [{f"rendering@renderings.{name}": name} for name in renderings]
    folder = {name: file.parent.name for name, file in apart.items()}
    defaults += [{f"view@views.{name}": f"{folder[name]}/{name}"} for name in sorted(seen)]
    store.store(name="views_and_renderings", node={"defaults": defaults})
    experiments = [
        read_yaml(file)
        for name in typed(words, "experiment")
        for file in _files(folders, f"experiment/{name}.yaml")
    ]
    experiment_views = [view for experiment in experiments for view in experiment.get("views", ())]
    # An earlier call may have registered another folder.
    store.repo.pop("cams", None)
    for rendering, view in product(renderings, [*views, *experiment_views, *apart]):
        name = f"{rendering}_{view}"
        node: dict[str, Any] = {CAMERAS: {name: {"view": view, "rendering": rendering}}}
        if view in apart:
            # An option may stand for several cameras, such as stereo, which no word names.
            node["views"] = {view: read_yaml(apart[view])}
        store.store(group="cams", name=name, node=node, package="_global_")


def _task_of(option: str, folders: Sequence[Path]) -> str:
    """The task of an option of the group ``task``: the name of its folder, as of ``reach/wide``.

    Options without a folder, such as ``wide``, are variants of the task of ``standard``.
    """
    name = option.partition("/")[0]
    if _files(folders, f"episode/{name}.yaml"):
        return name
    return str(read_yaml(folders[0] / "task/standard.yaml")["name"])


def variants(task: str, folders: Sequence[Path]) -> list[str]:
    """What ``task=`` may be for a task by its name."""
    options = {
        str(file.relative_to(folder / "task").with_suffix(""))
        for folder in folders
        for file in (folder / "task").rglob("*.yaml")
    }
    return sorted(option for option in options if _task_of(option, folders) == task)


def names(folders: Iterable[Path], group: str) -> list[str]:
    """Names of a group's files in config folders."""
    return sorted(file.stem for file in _files(folders, f"{group}/*.yaml"))


def _files(folders: Iterable[Path], pattern: str) -> list[Path]:
    return [file for folder in folders for file in sorted(folder.glob(pattern))]
