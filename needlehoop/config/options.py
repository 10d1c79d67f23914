"""Options of Hydra that are no files: cameras, and what follows from the task.

A camera ``dep_front`` is the view ``front`` in the rendering ``dep``. ``episode=default`` and
``reward=human`` are ``conf/episode/<task>.yaml`` and ``conf/reward/human/<task>.yaml``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore

from needlehoop.runs.reading import named, read_yaml

CAMERAS = "cameras"
"""The key of the chosen cameras in a composed config."""

OF_TASK = {"episode": ("default", "episode"), "reward": ("human", "reward/human")}
"""By group: the option that follows from the task, and the folder of its files."""

_PROVIDER = "needlehoop"
"""Tells Hydra whose options they are."""


def typed(words: Iterable[str], key: str) -> list[str]:
    """The values that a command line gives a key, as they were typed."""
    pairs = (word.lstrip("+").partition("=") for word in words)
    return [value for name, found, value in pairs if found and name == key]


def register(words: Iterable[str], folders: Sequence[Path], task: str | None = None) -> None:
    """Tell Hydra of the options that a command line may choose; of ``folders``, ours is the first.

    A run decides its ``task``. Raises ``ValueError`` for a sweep over several tasks.
    """
    given = list(words)
    _register_cameras(given, folders)
    chosen = ["standard", *typed(given, "task")][-1].strip("'\"").split(",")
    names = {task} if task else {task_of(option, folders) for option in chosen}
    if len(names) > 1:
        raise ValueError(f"task: a sweep is over one task's variants, not {', '.join(names)}")
    (name,) = names
    for group, (option, place) in OF_TASK.items():
        for file in _files(folders, f"{place}/{name}.yaml")[:1]:
            ConfigStore.instance().store(group=group, name=option, node=read_option(file))


def _register_cameras(words: Sequence[str], folders: Sequence[Path]) -> None:
    """Every pair of a view and a rendering is an option of the group ``cams``.

    A config has every view and rendering, but for views in a folder below ``view``: it has those
    that a word names. An experiment may have ``views`` of its own.
    """
    store = ConfigStore.instance()
    views, renderings = (names(folders, group) for group in ("view", "rendering"))
    apart = {file.stem: file for file in _files(folders, "view/*/*.yaml")}
    line = " ".join(words)
    seen = {name for name in apart if re.search(rf"[._]{re.escape(name)}\b", line)}
    defaults = [{f"view@views.{name}": name} for name in views]
    defaults += [{f"rendering@renderings.{name}": name} for name in renderings]
    defaults += [
        {f"view@views.{name}": f"{apart[name].parent.name}/{name}"} for name in sorted(seen)
    ]
    store.store(name="views_and_renderings", node={"defaults": defaults})
    experiments = [
        read_option(file)
        for name in typed(words, "experiment")
        for file in _files(folders, f"experiment/{name}.yaml")
    ]
    own = [view for one in experiments for view in one.get("views", ())]
    # An earlier call may have registered another folder. A host's own cams are not ours.
    known: dict[str, Any] = store.repo.get("cams", {})
    for option in [name for name, one in known.items() if one.provider == _PROVIDER]:
        del known[option]
    for rendering, view in product(renderings, [*views, *own, *apart]):
        name = f"{rendering}_{view}"
        node: dict[str, Any] = {CAMERAS: {name: {"view": view, "rendering": rendering}}}
        if view in apart:
            # An option may stand for several cameras, such as stereo, which no word names.
            node["views"] = {view: read_option(apart[view])}
        store.store(group="cams", name=name, node=node, package="_global_", provider=_PROVIDER)


def task_of(option: str, folders: Sequence[Path]) -> str:
    """The task of an option of the group ``task``: the name of its folder, as of ``reach/wide``.

    Options without a folder, such as ``wide``, are variants of the task of ``standard``.
    """
    name = option.partition("/")[0]
    if _files(folders, f"episode/{name}.yaml"):
        return name
    return str(read_option(folders[0] / "task/standard.yaml")["name"])


def variants(task: str, folders: Sequence[Path]) -> list[str]:
    """What ``task=`` may be for a task by its name."""
    found = {
        str(file.relative_to(folder / "task").with_suffix(""))
        for folder in folders
        for file in (folder / "task").rglob("*.yaml")
    }
    return sorted(option for option in found if task_of(option, folders) == task)


def names(folders: Iterable[Path], group: str) -> list[str]:
    """Names of a group's files in config folders."""
    return sorted(file.stem for folder in folders for file in (folder / group).glob("*.yaml"))


def _files(folders: Iterable[Path], pattern: str) -> list[Path]:
    return [file for folder in folders for file in sorted(folder.glob(pattern))]


def read_option(file: Path) -> dict[str, Any]:
    """An option's values; ``ValueError`` names a file that is no mapping in YAML."""
    with named(file):
        return read_yaml(file)
