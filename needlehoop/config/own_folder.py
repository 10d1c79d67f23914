"""Config folders of one's own, beside ``conf/``: ``conf_dir=<folder>``, and ``conf`` of a task.

A task from elsewhere is a folder (``task_dir=<folder>``) or an entry point of an installed package
(``task=<its name>``). Nothing of it is imported here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from needlehoop.config.options import OF_TASK, read_option, typed
from needlehoop.runs.shipped import CONF

KEY, TASK_KEY = "conf_dir", "task_dir"

GROUP = "needlehoop.tasks"
"""Entry points of installed packages: ``mine = "my_package.my_task:TASK"``."""


def part(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the config folders that it named.

    ``conf_dir=`` is taken out. ``task_dir=`` becomes a whole path, and chooses its only task if no
    task is named. Raises ``ValueError`` for one that is no config folder, or has a taken name.
    """
    given = list(words)
    folders = [Path(path).expanduser().resolve() for path in typed(given, KEY)]
    for folder in folders:
        _check(folder, KEY)
    rest = [word for word in given if not word.startswith(f"{KEY}=")]
    task, named = typed(rest, "task"), ["", *typed(rest, TASK_KEY)][-1].strip("'\"")
    if named not in ("", "null"):
        chosen = Path(named).expanduser().resolve()
        _check(chosen / "conf", TASK_KEY)
        rest = [word for word in rest if not word.startswith(f"{TASK_KEY}=")]
        rest += [f"{TASK_KEY}={in_quotes(str(chosen))}"]
        rest += [] if task else [f"task={_only_task(chosen)}"]
        folders.append(chosen / "conf")
    elif task:
        folders += _installed(task[-1], [CONF, *folders])
    return rest, folders


def in_quotes(path: str) -> str:
    """A path in quotes for Hydra, which takes ``=`` and ``{}`` for its own."""
    return "'" + path.replace("'", "\\'") + "'"


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
    if not folder.is_dir():
        raise ValueError(f"{key}: {str(folder)!r} is no folder")
    valid = sorted(one.name for one in CONF.iterdir() if one.is_dir())
    for group in sorted(one for one in folder.iterdir() if one.is_dir()):
        if group.name not in valid:
            raise ValueError(f"{key}: {group.name!r} is no group; choose from {', '.join(valid)}")
        ours = {*_names(CONF / group.name), *OF_TASK.get(group.name, ())[:1]}
        if group.name == "view":
            # Known by its name alone, whatever folder its file is in.
            ours = {Path(name).name for name in ours}
        for name in sorted({*_names(group)} & ours):
            raise ValueError(f"{key}: {group.name}/{name}.yaml: the name is taken; choose another")
    for file in folder.rglob("*.yaml"):
        # That folder is imported, and a file must not decide it.
        if TASK_KEY in read_option(file):
            raise ValueError(f"{file}: {TASK_KEY} counts only where you type it")


def _names(folder: Path) -> list[str]:
    return [str(file.relative_to(folder).with_suffix("")) for file in folder.rglob("*.yaml")]
