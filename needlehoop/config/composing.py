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

from needlehoop.config import options
from needlehoop.runs.shipped import CONF

_LISTS = re.compile(r"(\+*(?:cams|combinations|axes|severities)=)([^\[\]'\"]+)")


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
    ``cams=a,b`` becomes ``cams=[a,b]``, which Hydra takes for one value; under ``-m`` a comma list
    stays a sweep. Raises ``ValueError`` for a ``conf_dir`` or ``task_dir`` that is no such folder,
    or a camera that is named twice.
    """
    rest, folders = options.part(words)
    folders += [] if task_dir is None else [Path(task_dir) / "conf"]
    options.register(rest, [CONF, *folders], task)
    if not {"-m", "--multirun"} & {*rest}:
        rest = [_LISTS.sub(r"\1[\2]", word) if _LISTS.fullmatch(word) else word for word in rest]
    for text in options.typed(rest, "cams"):
        names = re.findall(r"\w+", text)
        # Hydra would take it once; several brackets are the lists of a sweep.
        if text.count("[") == 1 and len({*names}) < len(names):
            raise ValueError(f"cams: {text} names one twice")
    places = ",".join(options.in_quotes(f"file://{folder}") for folder in folders)
    return [*([f"hydra.searchpath=[{places}]"] if places else []), *rest], folders


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
            message = _explain(str(error), config)
        raise ValueError(message) from error


def _explain(text: str, config: str) -> str:
    """Hydra's message; an unknown key or option comes with the valid ones."""
    line = re.sub(r"\s*\n\s*", " ", text.partition("Config search path")[0]).strip()
    if option := re.search(r"Could not load '([^']+)/[^']+'", text):
        # One of several options of a group; of a single one, Hydra itself lists the others.
        valid = GlobalHydra.instance().config_loader().get_group_options(option[1])
        return f"{line} Available options in {option[1]!r}: {' '.join(valid)}"
    match = re.search(r"Could not override '([^']+)'", text)
    if not match:
        return line
    here: Any = hydra_compose(config)
    for key in match[1].split("."):
        if isinstance(here, DictConfig) and key not in here:
            valid = ", ".join(sorted({*map(str, here)} - {options.CAMERAS}))
            return f"{match[1]}: unknown key {key!r}; choose from {valid}"
        here = here[key] if isinstance(here, DictConfig) else None
    return line
