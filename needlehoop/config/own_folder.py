"""A config folder of one's own: ``conf_dir=<folder>``, views, tasks and all, beside ``conf/``.

Others may have written its files. Hydra reads one when it is chosen, and only within limits.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.sources_registry import SourcesRegistry
from hydra.plugins.config_source import ConfigResult

from needlehoop.config import camera_groups
from needlehoop.runs.reading import UnreadableError, read_yaml
from needlehoop.runs.shipped import CONF

KEY = "conf_dir"


class BoundedSource(FileConfigSource):
    """Hydra's folder of YAML files, each of which is checked before Hydra opens it."""

    @staticmethod
    def scheme() -> str:
        """What stands before ``://`` in Hydra's search path."""
        return "bounded"

    def load_config(self, config_path: str) -> ConfigResult:
        """Raises ``ValueError`` for a file that is no small mapping in YAML; names it."""
        file = Path(self.path) / self._normalize_file_name(config_path)
        if file.exists():
            try:
                read_yaml(file)
            except UnreadableError as error:
                raise ValueError(f"{KEY}: {file} {error}") from error
        return super().load_config(config_path)

    def is_config(self, config_path: str) -> bool:
        """Also of a pipe or a device, for ``load_config`` to name."""
        return (Path(self.path) / self._normalize_file_name(config_path)).exists()


def part(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line without ``conf_dir=``, and the folders that it named.

    Raises:
        ValueError: one that is no config folder, or has a name that is taken.
    """
    given = list(words)
    own = [word for word in given if word.startswith(f"{KEY}=")]
    folders = [Path(word.partition("=")[2]).expanduser().resolve() for word in own]
    for folder in folders:
        _check(folder)
    return [word for word in given if word not in own], folders


def search_path(folders: Iterable[Path]) -> list[str]:
    """Hydra's override that has it look into the folders; none for none."""
    SourcesRegistry.instance().register(BoundedSource)
    places = ",".join(repr(f"{BoundedSource.scheme()}://{folder}") for folder in folders)
    return [f"hydra.searchpath=[{places}]"] if places else []


def _check(folder: Path) -> None:
    """Raises ``ValueError`` for a folder or file that Hydra would silently ignore."""
    if not folder.is_dir():
        raise ValueError(f"{KEY}: {str(folder)!r} is no folder")
    valid = sorted(one.name for one in CONF.iterdir() if one.is_dir())
    for group in sorted(one.name for one in folder.iterdir() if one.is_dir()):
        if group not in valid:
            raise ValueError(f"{KEY}: {group!r} is no group; choose from {', '.join(valid)}")
        own, ours = (camera_groups.options(place, group) for place in (folder, CONF))
        for name in sorted({*own} & {*ours}):
            raise ValueError(f"{KEY}: {group}/{name}.yaml: the name is taken; choose another")
