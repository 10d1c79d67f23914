"""From Hydra's YAML and overrides to ``Settings``; nothing below knows omegaconf."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from needlehoop import groups, own, strict
from needlehoop.runs.shipped import CONF

if TYPE_CHECKING:
    # Both bring torch, which what is composed alone does without.
    from needlehoop.envs.settings import Settings
    from needlehoop.learning.job import Job

T = TypeVar("T")


def settings(overrides: Iterable[str] = (), config: str = "env") -> Settings:
    """Settings from a config file of ``conf/`` and Hydra overrides.

    Raises:
        ValueError: an unknown key, option or value; the message lists the valid ones.
    """
    return structure(compose(overrides, config))


def compose(overrides: Iterable[str] = (), config: str = "env") -> dict[str, Any]:
    """The composed config as plain values; errors as in ``settings``."""
    words, folders = prepare(overrides)
    places = ",".join(repr(f"file://{folder}") for folder in folders)
    searched = [f"hydra.searchpath=[{places}]"] if places else []
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose_here([*words, *searched], config)


def compose_here(overrides: Sequence[str], config: str) -> dict[str, Any]:
    """The same where Hydra is set up, and knows the options, already."""
    try:
        groups.check_choice(overrides, CONF)
        return plain(hydra_compose(config, overrides=list(overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        message = _explain(error, config)
        if not any(word.partition("=")[0].lstrip("+~") in message for word in overrides):
            message += f" (in: {' '.join(overrides)})"
        raise ValueError(message) from error


def structure(values: dict[str, Any]) -> Settings:
    """What somebody typed as checked dataclasses; keys of other tools are left aside."""
    from needlehoop import rewards
    from needlehoop.envs.settings import Settings

    missing = [name for name in Settings.__dataclass_fields__ if name not in values]
    if missing:
        raise ValueError(f"{missing[0]}: missing; every environment needs it")
    own = {name: values[name] for name in Settings.__dataclass_fields__}
    found = _structure(own, Settings)
    return replace(found, reward=rewards.allow(found.reward))


def job(values: dict[str, Any]) -> Job:
    """What somebody typed as a checked ``Job``; errors as in ``settings``."""
    from needlehoop import rewards

    found = checked_job(values)
    return replace(found, env=replace(found.env, reward=rewards.allow(found.env.reward)))


def recorded_job(values: dict[str, Any], trust: bool) -> Job:
    """The job of a run's own config. Python code that it names runs only with ``trust``.

    Raises:
        ValueError: there is such code and no trust, or as in ``settings``.
    """
    from needlehoop import rewards

    found = checked_job(values)
    return replace(found, env=replace(found.env, reward=rewards.recall(found.env.reward, trust)))


def checked_job(values: dict[str, Any]) -> Job:
    """A training config as a ``Job`` whose reward can run no code; errors as in ``settings``."""
    from needlehoop.learning.job import Job, split

    return _structure(split(values), Job)


def as_type(values: Mapping[str, Any], kind: type[T], path: str = "") -> T:
    """The values that a dataclass names, as one; errors as in ``settings``.

    Args:
        values: of a composed config; with a ``path`` there may be no others.
        kind: the dataclass.
        path: where the values stand in the config.
    """
    if path:
        return _structure(values, kind, path)
    names = getattr(kind, "__dataclass_fields__", {})
    return _structure({name: values[name] for name in names}, kind)


def value(values: Mapping[str, Any], key: str, kind: Any) -> Any:
    """One value of a composed config: a whole number, a truth, a text, a list of names, …

    Raises:
        ValueError: it is something else; says the key.
    """
    return strict.structure(values[key], kind, key)


def check_choice(words: Iterable[str]) -> None:
    """Whether the words of a sweep choose cameras as Hydra takes them.

    Raises:
        ValueError: they do not, or a word is no override.
    """
    try:
        groups.check_choice(words, CONF)
    except HydraException as error:
        raise ValueError(_one_line(str(error))) from error


def in_brackets(words: Iterable[str]) -> list[str]:
    """A command line with ``cams=a,b`` as ``cams=[a,b]``, which Hydra takes for one value.

    Under ``-m`` a bare comma list stays what Hydra makes of it: a sweep.
    """
    given = list(words)
    if {"-m", "--multirun"} & set(given):
        return given
    return [re.sub(r"^(\+*cams=)([^\[\]'\"]*,[^\[\]'\"]*)$", r"\1[\2]", word) for word in given]


def quoted(word: str) -> str:
    """``resume=`` with its path in quotes for Hydra, which takes ``=`` and ``{}`` for its own."""
    key, _, path = word.partition("=")
    if key != "resume" or path in ("", "null") or path[0] in "'\"":
        return word
    escaped = re.sub(r"(\\*)'", lambda found: 2 * found[1] + "\\'", path)
    trailing = len(path) - len(path.rstrip("\\"))
    return f"resume='{escaped}{trailing * chr(92)}'"


def _structure(values: Mapping[str, Any], kind: type[T], path: str = "") -> T:
    try:
        return strict.structure(values, kind, path)
    except ValueError as error:
        # Where the environment's keys live in a ``Job``, not in the YAML.
        raise ValueError(re.sub(r"(^|; )env(\.|: )", r"\1", str(error))) from error


def prepare(words: Iterable[str]) -> tuple[list[str], list[Path]]:
    """A command line as Hydra takes it, and the folders of one's own that it named.

    Hydra is told of the options that are not files, here and in those folders.

    Raises:
        ValueError: ``conf_dir`` is no config folder.
    """
    rest, folders = own.part(words)
    groups.register(CONF, *folders)
    return in_brackets(rest), folders


def plain(composed: DictConfig) -> dict[str, Any]:
    """A composed config as plain values; the chosen cameras are the list ``cams``, no more.

    Raises:
        ValueError: a camera that is not what its name says.
    """
    whole = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    assert isinstance(whole, dict)
    values = {str(key): value for key, value in whole.items()}
    groups.check_cameras(values.pop(groups.CAMERAS, {}))
    return values


def _explain(error: Exception, config: str) -> str:
    """Hydra's message; for an unknown key or option, with those that there are."""
    text = str(error)
    if option := re.search(r"Could not load '([^']+)/[^']+'", text):
        # One of several options of a group; of a single one, Hydra itself lists the others.
        valid = GlobalHydra.instance().config_loader().get_group_options(option.group(1))
        return f"{_one_line(text)} Available options in {option.group(1)!r}: {' '.join(valid)}"
    found = re.search(r"Could not override '([^']+)'", text)
    if not found:
        return _one_line(text)
    here: Any = hydra_compose(config)
    known: list[str] = []
    for key in found.group(1).split("."):
        if not isinstance(here, DictConfig):
            break
        if key not in here:
            where = ".".join(known) or "the top level"
            valid = ", ".join(sorted({*map(str, here)} - {groups.CAMERAS}))
            return f"{found.group(1)}: unknown key {key!r} in {where}; choose from {valid}"
        known.append(key)
        here = here[key]
    return _one_line(text)


def _one_line(text: str) -> str:
    """Hydra's message without the folders it searched."""
    return re.sub(r"\s*\n\s*", " ", text.partition("Config search path")[0]).strip()
