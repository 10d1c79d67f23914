"""From Hydra's YAML and overrides to plain values. No other room knows omegaconf."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.basecontainer import BaseContainer
from omegaconf.errors import OmegaConfBaseException

from needlehoop.config import options, own_folder
from needlehoop.runs.shipped import CONF

_typed: set[str] | None = None
"""Environment variables that were typed; ``None`` where a launcher's process does not know yet."""


def allow_variables(words: Iterable[str]) -> None:
    """From now on ``${oc.env:NAME}`` is read where these words name it, and nowhere else.

    A config file of somebody else's could otherwise carry a secret into a run's files.
    """
    global _typed
    _typed = {name for word in words for name in re.findall(r"\$\{oc\.env:\s*(\w+)", word)}


def _variable(name: str, *default: Any) -> Any:
    """OmegaConf's ``oc.env``, for variables that were typed."""
    if _typed is not None and name not in _typed:
        raise ValueError(f"environment variables are read only where you type them: {name}")
    if name not in os.environ and not default:
        raise ValueError(f"the environment variable {name} is not set")
    return os.environ.get(name, *default)


@contextmanager
def guarded() -> Iterator[None]:
    """Within it ``${oc.env:NAME}`` is read as ``allow_variables`` says; elsewhere as ever.

    A host program may well use OmegaConf, too.
    """
    known = BaseContainer._resolvers
    theirs = known["oc.env"]
    OmegaConf.register_new_resolver("oc.env", _variable, replace=True)
    try:
        yield
    finally:
        known["oc.env"] = theirs


def compose(overrides: Iterable[str] = (), config: str = "env") -> dict[str, Any]:
    """A config of ``conf/`` with overrides, as plain values; a ``ValueError`` lists valid words."""
    words, _ = prepare(overrides)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose_here(words, config)


def compose_here(overrides: Sequence[str], config: str) -> dict[str, Any]:
    """The same, where Hydra is set up and knows the options already."""
    with _explained(overrides, config):
        return plain(hydra_compose(config, overrides=list(overrides)))


def swept(overrides: Sequence[str]) -> dict[str, Any]:
    """What an experiment that is among these words sweeps over, where Hydra is set up."""
    with _explained(overrides, "config"):
        whole = hydra_compose("config", overrides=list(overrides), return_hydra_config=True)
        return dict(whole.hydra.sweeper.params or {})


@contextmanager
def _explained(overrides: Sequence[str], config: str) -> Iterator[None]:
    options.check_choice(overrides, CONF)
    try:
        with guarded():
            yield
    except (HydraException, OmegaConfBaseException) as error:
        raise ValueError(options.of_words(_explain(error, config), overrides)) from error


def in_brackets(words: Iterable[str]) -> list[str]:
    """A command line with ``cams=a,b`` as ``cams=[a,b]``, which Hydra takes for one value.

    So is a single one of ``axes`` and ``severities``. Under ``-m`` a comma list stays a sweep.
    """
    given = list(words)
    if {"-m", "--multirun"} & set(given):
        return given
    cams = (r"^(\+*cams=)([^\[\]'\"]*,[^\[\]'\"]*)$", r"\1[\2]")
    tests = (r"^((?:axes|severities)=)([^\[\]'\"]+)$", r"\1[\2]")
    # Every axis is in the config already; people add one to none.
    for pattern, into in (cams, tests, (r"^\+disturb\.", "disturb.")):
        given = [re.sub(pattern, into, word) for word in given]
    return given


def quoted(word: str) -> str:
    """``resume=`` with its path in quotes for Hydra."""
    key, _, path = word.partition("=")
    if key != "resume" or path in ("", "null") or path[0] in "'\"":
        return word
    return f"resume={own_folder.in_quotes(path)}"


def prepare(
    words: Iterable[str], task: str | None = None, task_dir: str | None = None
) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the config folders of one's own that it named.

    Also registers the options that are no files. A run decides its ``task`` and ``task_dir``.
    Raises ``ValueError`` for a ``conf_dir`` or ``task_dir`` that is no such folder.
    """
    rest, folders = own_folder.part(words)
    folders += [] if task_dir is None else [Path(task_dir) / "conf"]
    allow_variables(rest)
    options.register_cameras(rest, [CONF, *folders])
    options.register_task(rest, [CONF, *folders], task)
    return [*own_folder.search_path(folders), *in_brackets(rest)], folders


def plain(composed: DictConfig) -> dict[str, Any]:
    """A composed config as plain values; the chosen cameras are the list ``cams``, no more.

    Raises ``ValueError`` for a camera that is not what its name says.
    """
    with guarded():
        whole = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    assert isinstance(whole, dict)
    values = {str(key): value for key, value in whole.items()}
    options.check_cameras(values.pop(options.CAMERAS, {}))
    return values


def _explain(error: Exception, config: str) -> str:
    """Hydra's message; an unknown key or option comes with the valid ones."""
    text = str(error)
    if option := re.search(r"Could not load '([^']+)/[^']+'", text):
        # One of several options of a group; of a single one, Hydra itself lists the others.
        valid = GlobalHydra.instance().config_loader().get_group_options(option.group(1))
        return (
            f"{options.one_line(text)} Available options in {option.group(1)!r}: {' '.join(valid)}"
        )
    found = re.search(r"Could not override '([^']+)'", text)
    if not found:
        return options.one_line(text)
    here: Any = hydra_compose(config)
    known: list[str] = []
    for key in found.group(1).split("."):
        if not isinstance(here, DictConfig):
            break
        if key not in here:
            where = ".".join(known) or "the top level"
            valid = ", ".join(sorted({*map(str, here)} - {options.CAMERAS}))
            return f"{found.group(1)}: unknown key {key!r} in {where}; choose from {valid}"
        known.append(key)
        here = here[key]
    return options.one_line(text)
