"""Hydra's options that are no files: cameras, and the models that experiments sweep over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser

from needlehoop.config.strict import shown
from needlehoop.config.task_options import OPTIONS
from needlehoop.runs.reading import UnreadableError, read_yaml

CAMERAS = "cameras"
"""The key of the chosen cameras in a composed config."""


_LONGEST = 100
"""Characters of an option's name, at most: it is the name of a file."""


def register(words: Sequence[str], *folders: Path) -> None:
    """Tell Hydra which cameras and models there are.

    Args:
        folders: the shipped one first.

    A new view or rendering is one new file: every file is part of an environment's config, and
    every pair of view and rendering is an option of the group ``cams``.
    """
    store = ConfigStore.instance()
    found = {
        group: sorted(name for folder in folders for name in options(folder, group))
        for group in ("view", "rendering")
    }
    own = _experiments(words, folders)
    defaults: list[Any] = [
        {f"{group}@{group}s.{name}": name} for group, names in found.items() for name in names
    ]
    store.store(name="views_and_renderings", node={"defaults": defaults})
    # An earlier call may have registered another folder.
    store.repo.pop("cams", None)
    for rendering in found["rendering"]:
        for view in [*found["view"], *chain(*(values.get("views", ()) for values in own))]:
            name = f"{rendering}_{view}"
            node = {"view": view, "rendering": rendering}
            store.store(group="cams", name=name, node=node, package=f"{CAMERAS}.{name}")
    for name in _models(words, own):
        cameras, _, reward = name.rpartition(".")
        node = {"defaults": [{"override /reward": reward}, {"override /cams": cameras.split("+")}]}
        store.store(group="model", name=name, node=node, package="_global_")


def check_choice(overrides: Iterable[str], conf: Path) -> None:
    """Check chosen options where Hydra itself says nothing, or nothing clear.

    Args:
        overrides: as Hydra takes them, sweeps included.

    Raises:
        ValueError: ``cams`` is no list of names or repeats one, or the choice of another group
            is no name.
        HydraException: a word is no override.
    """
    groups = {folder.name for folder in conf.iterdir() if folder.is_dir()}
    for override in OverridesParser.create().parse_overrides(list(overrides)):
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


def _check_cams(chosen: Any) -> None:
    names = [chosen] if isinstance(chosen, str) else chosen
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"cams: {shown(chosen)} is no list of cameras, as dep_front,seg_side is")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"cams: {name!r} is named twice")


def check_cameras(cameras: Mapping[str, Any]) -> None:
    """Check that the chosen cameras of a composed config are what their names say.

    Raises:
        ValueError: one has another view or rendering.
    """
    for name, camera in cameras.items():
        if not isinstance(camera, Mapping) or name != "_".join(
            str(camera.get(part)) for part in ("rendering", "view")
        ):
            raise ValueError(
                f"{CAMERAS}.{name}: a camera is the rendering and the view of its name; choose"
                " another with cams=, or add a file to conf/view or conf/rendering"
            )


def options(folder: Path, group: str) -> list[str]:
    """Options of a group in a config folder: files, and the option that follows from the task."""
    files = (file.stem for file in (folder / group).glob("*.yaml"))
    option, place = OPTIONS.get(group, ("", ""))
    made = [option] if option and any((folder / place).glob("*.yaml")) else []
    return sorted({*files, *made})


def _experiments(words: Iterable[str], folders: Sequence[Path]) -> list[Mapping[str, Any]]:
    """The files of chosen experiments, read. One may have ``views`` of its own."""
    chosen = {word.partition("=")[2] for word in words if word.startswith("+experiment=")}
    found = []
    for file in (folder / "experiment" / f"{name}.yaml" for folder in folders for name in chosen):
        if file.exists():
            try:
                values: Any = read_yaml(file)
            except UnreadableError as error:
                raise ValueError(f"experiment: {file} {error}") from error
            found += [values] if isinstance(values, Mapping) else []
    return found


def _swept(experiments: Iterable[Any], key: str) -> list[str]:
    found = []
    for values in experiments:
        # Not every experiment is a sweep.
        for part in ("hydra", "sweeper", "params", key):
            values = values.get(part) if isinstance(values, Mapping) else None
        found += [values] if isinstance(values, str) else []
    return found


def _models(words: Iterable[str], experiments: Iterable[Any]) -> list[str]:
    """Values of ``+model`` (cameras and reward in one word), typed or of a chosen experiment."""
    found = [word.partition("=")[2] for word in words if word.startswith("+model=")]
    found += _swept(experiments, "+model")
    names = [name.strip() for text in found for name in text.split(",")]
    return [name for name in names if "." in name]
