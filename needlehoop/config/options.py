"""Hydra's options that are no files of their own: cameras, models, and what follows from the task.

A camera is a pair of a view and a rendering. A model, over which experiments sweep, is cameras and
a reward. ``episode=default`` and ``reward=human`` are the task's own: their files are
``conf/episode/<task>.yaml`` and ``conf/reward/human/<task>.yaml``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from needlehoop.config.strict import shown
from needlehoop.runs.reading import named, read_yaml

CAMERAS = "cameras"
"""The key of the chosen cameras in a composed config."""

OF_TASK = {"episode": ("default", "episode"), "reward": ("human", "reward/human")}
"""By group: the option, and the folder of its files below a config folder."""

_PROVIDER = "needlehoop"
"""Tells Hydra whose options they are."""

_LONGEST = 100
"""Characters of an option's name, at most: it is the name of a file."""


def typed(words: Iterable[str], key: str) -> list[str]:
    """The values that a command line gives a key, as they were typed."""
    pairs = (word.lstrip("+").partition("=") for word in words)
    return [value for name, found, value in pairs if found and name == key]


def register_cameras(words: Iterable[str], folders: Sequence[Path]) -> None:
    """Tell Hydra which cameras and models there are; of the config folders ours is the first.

    A new view or rendering is one new file: every file is part of an environment's config, and
    every pair of view and rendering is an option of the group ``cams``. A view in a folder below
    ``view`` is part of a config only where a camera has it, or where a word names it that chooses
    no cameras. An experiment that the words choose may have ``views`` of its own.
    """
    store = ConfigStore.instance()
    given = list(words)
    found = {
        group: sorted(name for folder in folders for name in options(folder, group))
        for group in ("view", "rendering")
    }
    apart = views_apart(folders)
    defaults = [{f"{group}@{group}s.{name}": name} for group in found for name in found[group]]
    kinds = "|".join(map(re.escape, found["rendering"]))
    others = " ".join(word for word in given if not re.match(r"\+*(cams|model)=", word))
    defaults += [
        {f"view@views.{name}": option}
        for name, (option, _) in apart.items()
        if re.search(rf"\b(views\.|({kinds})_){re.escape(name)}\b", others)
    ]
    store.store(name="views_and_renderings", node={"defaults": defaults})
    names = {*typed(given, "experiment")}
    files = [folder / "experiment" / f"{name}.yaml" for folder in folders for name in names]
    experiments = [read_option(file) for file in files if file.exists()]
    views = [*found["view"], *(view for own in experiments for view in own.get("views", ()))]
    # An earlier call may have registered another folder. A host's own cams are not ours.
    known = store.repo.get("cams", {})
    for option in [name for name, one in known.items() if one.provider == _PROVIDER]:
        del known[option]
    for rendering, view in product(found["rendering"], [*views, *apart]):
        name, camera = f"{rendering}_{view}", {"view": view, "rendering": rendering}
        node: dict[str, Any] = {CAMERAS: {name: camera}}
        if view in apart:
            node["views"] = {view: read_option(apart[view][1])}
        own = {"node": node, "package": "_global_", "provider": _PROVIDER}
        store.store(group="cams", name=name, **own)
    for name in _models(given, experiments):
        cameras, _, reward = name.rpartition(".")
        node = {"defaults": [{"override /reward": reward}, {"override /cams": cameras.split("+")}]}
        store.store(group="model", name=name, node=node, package="_global_")


def views_apart(folders: Iterable[Path]) -> dict[str, tuple[str, Path]]:
    """Views in folders below ``view`` by name: their option of that group, and their file."""
    found: dict[str, tuple[str, Path]] = {}
    for folder in folders:
        for file in sorted((folder / "view").glob("*/*.yaml")):
            found[file.stem] = (f"{file.parent.name}/{file.stem}", file)
    return found


def _models(words: Iterable[str], experiments: Iterable[Any]) -> list[str]:
    """Values of ``+model`` (cameras and reward in one word), typed or of a chosen experiment."""
    texts = typed(words, "model")
    for values in experiments:
        # Not every experiment is a sweep.
        for part in ("hydra", "sweeper", "params", "+model"):
            values = values.get(part) if isinstance(values, Mapping) else None
        texts += [values] if isinstance(values, str) else []
    names = [name.strip() for text in texts for name in text.split(",")]
    return [name for name in names if "." in name]


def register_task(words: Iterable[str], folders: Sequence[Path], task: str | None = None) -> None:
    """Tell Hydra what the options are for the task that a command line or a run (``task``) names.

    Raises ``ValueError`` for a sweep over different tasks, or a file that cannot be read.
    """
    given = ["standard", *typed(words, "task")][-1].split(",")
    found = [task] if task else (task_name(option, folders) for option in given)
    names = {name for name in found if name is not None}
    if len(names) > 1:
        raise ValueError(f"task: a sweep is over one task's variants, not {', '.join(names)}")
    store = ConfigStore.instance()
    for group, (option, place) in OF_TASK.items():
        for name in names:
            file = _file(folders, place, name)
            if file is not None:
                store.store(group=group, name=option, node=read_option(file))


def task_name(option: str, folders: Sequence[Path]) -> str | None:
    """The task of an option of the group ``task``; ``None`` where there is no such option.

    An option names its task or builds on one that does, over at most eight files.
    """
    for _ in range(8):
        file = _file(folders, "task", option)
        if file is None:
            return None
        values = read_option(file)
        if "name" in values:
            return str(values["name"])
        below = [one for one in values.get("defaults") or [] if one != "_self_"]
        if not below or not isinstance(below[0], str):
            return None
        option = below[0].partition("@")[0]
    return None


def variants(name: str, folders: Sequence[Path]) -> list[str]:
    """What ``task=`` may be for a task by its name: options that name it or build on such."""
    found = {
        str(file.relative_to(folder / "task").with_suffix(""))
        for folder in folders
        for file in (folder / "task").rglob("*.yaml")
    }
    return sorted(option for option in found if task_name(option, folders) == name)


def _file(folders: Sequence[Path], place: str, name: str) -> Path | None:
    files = (folder / place / f"{name}.yaml" for folder in folders)
    return next((file for file in files if file.is_file()), None)


def options(folder: Path, group: str) -> list[str]:
    """Options of a group in a config folder: files, and the option that follows from the task."""
    files = (file.stem for file in (folder / group).glob("*.yaml"))
    option, place = OF_TASK.get(group, ("", ""))
    made = [option] if option and any((folder / place).glob("*.yaml")) else []
    return sorted({*files, *made})


def check_choice(overrides: Iterable[str], conf: Path) -> None:
    """Check chosen options, those of sweeps too, where Hydra says nothing, or nothing clear.

    Raises:
        ValueError: ``cams`` is no list of names or repeats one, the choice of another group is no
            name, or a word is no override.
    """
    words = list(overrides)
    groups = {folder.name for folder in conf.iterdir() if folder.is_dir()}
    try:
        parsed = OverridesParser.create().parse_overrides(words)
    except HydraException as error:
        raise ValueError(of_words(one_line(str(error)), words)) from error
    for override in parsed:
        group = override.key_or_group
        if override.is_delete() or group not in {"cams", *groups}:
            continue
        swept = override.is_sweep_override()
        for chosen in override.sweep_iterator() if swept else [override.value()]:
            if group == "cams":
                _check_cams(chosen)
            elif not isinstance(chosen, str) or len(chosen) > _LONGEST:
                valid = ", ".join(options(conf, group))
                raise ValueError(f"{group}: {shown(chosen)} is no option; choose from {valid}")


def one_line(text: str) -> str:
    """Hydra's message without the folders it searched."""
    return re.sub(r"\s*\n\s*", " ", text.partition("Config search path")[0]).strip()


def of_words(message: str, words: Iterable[str]) -> str:
    """A message with the words that it is about, where it names none of them."""
    given = list(words)
    is_named = any(word.partition("=")[0].lstrip("+~") in message for word in given)
    return message if is_named else f"{message} (in: {' '.join(given)})"


def _check_cams(chosen: Any) -> None:
    names = [chosen] if isinstance(chosen, str) else chosen
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"cams: {shown(chosen)} is no list of cameras, as dep_front,seg_side is")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"cams: {name!r} is named twice")


def check_cameras(cameras: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` for a camera of another view or rendering than its name says."""
    for name, camera in cameras.items():
        if not isinstance(camera, Mapping) or name != "_".join(
            str(camera.get(part)) for part in ("rendering", "view")
        ):
            raise ValueError(
                f"{CAMERAS}.{name}: a camera is the rendering and the view of its name; choose"
                " another with cams=, or add a file to conf/view or conf/rendering"
            )


def read_option(file: Path) -> dict[str, Any]:
    """An option's values; ``ValueError`` names a file that is no small mapping in YAML."""
    with named(file):
        return read_yaml(file)
