"""Options that are made and not files: cameras, and the models that experiments sweep over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser

from needlehoop.config.strict import shown

CAMERAS = "cameras"
"""Where a composed config holds the options of the group ``cams`` that were chosen."""


_LONGEST = 100
"""Characters of an option's name: it is that of a file."""


def register(*folders: Path) -> None:
    """Tell Hydra of what follows from the files of config folders.

    Reading the folders keeps a new view or rendering a matter of one file: all of them are in
    an environment's config, and every pair of them is an option of the group ``cams``.
    """
    store = ConfigStore.instance()
    found = {
        group: sorted(name for folder in folders for name in options(folder, group))
        for group in ("view", "rendering")
    }
    defaults: list[Any] = [
        {f"{group}@{group}s.{name}": name} for group, names in found.items() for name in names
    ]
    store.store(name="views_and_renderings", node={"defaults": defaults})
    # What an earlier call told of another folder is no longer true.
    store.repo.pop("cams", None)
    for rendering in found["rendering"]:
        for view in found["view"]:
            name = f"{rendering}_{view}"
            node = {"view": view, "rendering": rendering}
            store.store(group="cams", name=name, node=node, package=f"{CAMERAS}.{name}")
    for name in (name for folder in folders for name in _models(folder)):
        cameras, _, reward = name.rpartition(".")
        node = {"defaults": [{"override /reward": reward}, {"override /cams": cameras.split("+")}]}
        store.store(group="model", name=name, node=node, package="_global_")


def check_choice(overrides: Iterable[str], conf: Path) -> None:
    """What Hydra lets pass, or stumbles over, in the choice of options.

    Args:
        overrides: as Hydra takes them, sweeps included.
        conf: folder of the groups.

    Raises:
        ValueError: a choice of ``cams`` that is no list of names, or has one of them twice; of
            another group, one that is no name.
        HydraException: what is no override at all.
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
    """Whether the chosen cameras of a composed config, by name, are what their names say.

    Raises:
        ValueError: one was given another view or rendering.
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
    """Options of a group that are files of a config folder."""
    return sorted(file.stem for file in (folder / group).glob("*.yaml"))


def _models(conf: Path) -> list[str]:
    """What experiments sweep over as ``+model``: cameras and reward in one word."""
    found = []
    for file in sorted((conf / "experiment").glob("*.yaml")):
        # Not every experiment is a sweep.
        hydra = yaml.safe_load(file.read_text()).get("hydra", {})
        params = hydra.get("sweeper", {}).get("params", {})
        found += [name.strip() for name in params.get("+model", "").split(",") if name.strip()]
    return found
