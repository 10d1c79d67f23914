"""From Hydra's YAML and overrides to plain values. No other room knows omegaconf."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from needlehoop.config import options, own_folder
from needlehoop.runs.shipped import CONF

MULTIRUN = {"-m", "--multirun"}


def compose(overrides: Iterable[str] = (), config: str = "env") -> dict[str, Any]:
    """A config of ``conf/`` with overrides, as plain values; a ``ValueError`` lists valid words."""
    words, _ = prepare(overrides)
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose_here(words, config)


def compose_here(overrides: Sequence[str], config: str) -> dict[str, Any]:
    """The same, where Hydra is set up and knows the options already."""
    with explained(config):
        return plain(hydra_compose(config, overrides=list(overrides)))


def swept(overrides: Iterable[str]) -> dict[str, Any]:
    """What an experiment that is among these words sweeps over, by key."""
    words, _ = prepare(overrides)
    with initialize_config_dir(str(CONF), version_base="1.3"), explained("config"):
        whole = hydra_compose("config", overrides=words, return_hydra_config=True)
        return dict(whole.hydra.sweeper.params or {})


def prepare(
    words: Iterable[str], task: str | None = None, task_dir: str | None = None
) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the config folders of one's own that it named.

    Also registers the options that are no files. A run decides its ``task`` and ``task_dir``.
    Raises ``ValueError`` for a ``conf_dir`` or ``task_dir`` that is no such folder.
    """
    rest, folders = own_folder.part(words)
    folders += [] if task_dir is None else [Path(task_dir) / "conf"]
    options.register(rest, [CONF, *folders], task)
    rest = [_quoted(word) for word in rest]
    places = ",".join(own_folder.in_quotes(f"file://{folder}") for folder in folders)
    found = [f"hydra.searchpath=[{places}]"] if places else []
    rest = in_brackets(rest)
    for text in options.typed(rest, "cams"):
        names = re.sub(r"[\[\]'\" ]", "", text).split(",")
        # Hydra would take it once; brackets within are lists of a sweep.
        if re.fullmatch(r"\[[^\[\]]*\]", text) and len({*names}) < len(names):
            raise ValueError(f"cams: {text} names one twice")
    return [*found, *rest], folders


def _quoted(word: str) -> str:
    """``resume=`` with its path in quotes for Hydra."""
    key, _, path = word.partition("=")
    is_plain = key == "resume" and path not in ("", "null") and path[0] not in "'\""
    return f"resume={own_folder.in_quotes(path)}" if is_plain else word


def in_brackets(words: Iterable[str]) -> list[str]:
    """A command line with ``cams=a,b`` as ``cams=[a,b]``, which Hydra takes for one value.

    So is a single one of ``axes`` and ``severities``. Under ``-m`` a comma list stays a sweep.
    """
    given = list(words)
    if MULTIRUN & set(given):
        return given
    cams = (r"^(\+*cams=)([^\[\]'\"]*,[^\[\]'\"]*)$", r"\1[\2]")
    tests = (r"^((?:axes|severities)=)([^\[\]'\"]+)$", r"\1[\2]")
    # Every axis is in the config already; people add one to none.
    for pattern, into in (cams, tests, (r"^\+disturb\.", "disturb.")):
        given = [re.sub(pattern, into, word) for word in given]
    return given


def plain(composed: DictConfig) -> dict[str, Any]:
    """A composed config as plain values; the chosen cameras are the list ``cams``, no more."""
    whole = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    assert isinstance(whole, dict)
    return {str(key): value for key, value in whole.items() if key != options.CAMERAS}


@contextmanager
def explained(config: str) -> Iterator[None]:
    """Turns Hydra's errors into a ``ValueError`` of one line that lists what is valid."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        # Hydra's own command line is over by now.
        is_over = not GlobalHydra.instance().is_initialized()
        with initialize_config_dir(str(CONF), version_base="1.3") if is_over else nullcontext():
            said = _explain(str(error), config)
        raise ValueError(said) from error


def _explain(text: str, config: str) -> str:
    """Hydra's message; an unknown key or option comes with the valid ones."""
    line = re.sub(r"\s*\n\s*", " ", text.partition("Config search path")[0]).strip()
    if option := re.search(r"Could not load '([^']+)/[^']+'", text):
        # One of several options of a group; of a single one, Hydra itself lists the others.
        valid = GlobalHydra.instance().config_loader().get_group_options(option.group(1))
        return f"{line} Available options in {option.group(1)!r}: {' '.join(valid)}"
    found = re.search(r"Could not override '([^']+)'", text)
    if not found:
        return line
    here: Any = hydra_compose(config)
    known: list[str] = []
    for key in found[1].split("."):
        if not isinstance(here, DictConfig):
            break
        if key not in here:
            where = ".".join(known) or "the top level"
            valid = ", ".join(sorted({*map(str, here)} - {options.CAMERAS}))
            return f"{found[1]}: unknown key {key!r} in {where}; choose from {valid}"
        known.append(key)
        here = here[key]
    return line
