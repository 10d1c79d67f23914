"""From Hydra's YAML and overrides to ``Settings``; nothing below knows omegaconf."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import cattrs
from hydra import compose as hydra_compose
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from needlehoop import groups, own
from needlehoop.runs.files import DAGGER, listed
from needlehoop.runs.shipped import CONF

if TYPE_CHECKING:
    # Both bring torch, which what is composed alone does without.
    from needlehoop.envs.settings import Settings
    from needlehoop.learning.job import Job

T = TypeVar("T")

_ALGORITHMS = {False: "PpoConfig", True: "DaggerConfig"}
"""Values of algorithms, by whether they are imitation's."""


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
        groups.check_choice(overrides)
        return plain(hydra_compose(config, overrides=list(overrides)))
    except (HydraException, OmegaConfBaseException) as error:
        message = _explain(error, config)
        if not any(word.partition("=")[0].lstrip("+~") in message for word in overrides):
            message += f" (in: {' '.join(overrides)})"
        raise ValueError(message) from error


def structure(values: dict[str, Any]) -> Settings:
    """Plain values as checked dataclasses; keys of other tools are left aside."""
    from needlehoop.envs.settings import Settings

    missing = [name for name in Settings.__dataclass_fields__ if name not in values]
    if missing:
        raise ValueError(f"{missing[0]}: missing; every environment needs it")
    return _structure({name: values[name] for name in Settings.__dataclass_fields__}, Settings)


def job(values: dict[str, Any]) -> Job:
    """A composed training config as a checked ``Job``; errors as in ``settings``."""
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
        return _structure(dict(values), kind, path)
    names = getattr(kind, "__dataclass_fields__", {})
    return _structure({name: values[name] for name in names}, kind)


def value(values: Mapping[str, Any], key: str, kind: type[T]) -> T:
    """One whole number, truth or text of a composed config.

    Raises:
        ValueError: it is something else; says the key.
    """
    try:
        return _converter.structure(values[key], kind)
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error


def check_choice(words: Iterable[str]) -> None:
    """Whether the words of a sweep choose cameras as Hydra takes them.

    Raises:
        ValueError: they do not, or a word is no override.
    """
    try:
        groups.check_choice(words)
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


def _structure(values: dict[str, Any], kind: type[T], path: str = "") -> T:
    try:
        return _converter.structure(values, kind)
    except cattrs.ClassValidationError as error:
        raise ValueError("; ".join(_plain(line) for line in _flatten(error, path))) from error


def _plain(line: str) -> str:
    """``env`` is where the environment's keys live in a ``Job``, not in the YAML."""
    return line.removeprefix("env: ").removeprefix("env.")


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


def _flatten(error: BaseException, path: str = "") -> Iterable[str]:
    """One line per invalid value, named by its key."""
    if isinstance(error, cattrs.IterableValidationError | cattrs.ClassValidationError):
        notes = {id(inner): note for inner, note in error.group_exceptions()[0]}
        for inner in error.exceptions:
            note = notes.get(id(inner))
            name = str(getattr(note, "name", getattr(note, "index", ""))) if note else ""
            yield from _flatten(inner, f"{path}.{name}" if path and name else path or name)
    elif isinstance(error, KeyError):
        yield f"{path or error.args[0]}: missing"
    elif isinstance(error, cattrs.ForbiddenExtraKeysError):
        yield f"{path}: unknown key {', '.join(sorted(error.extra_fields))}"
    elif path and not str(error).startswith(path.split(".")[0]):
        yield f"{path}: {error}"
    else:
        yield str(error)


def _whole_number(value: Any, _: type) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or value % 1 != 0:
        raise ValueError(f"{value!r} is not a whole number")
    return int(value)


def _truth(value: Any, _: type) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is not true or false")
    return value


def _is_algorithm(kind: Any) -> bool:
    """Whether it is the union of the algorithms' values; by name, since they bring torch."""
    return {one.__name__ for one in get_args(kind)} == {*_ALGORITHMS.values()}


def _algorithm(value: Any, union: Any) -> Any:
    """By its ``kind``, which PPO's values have none of."""
    wanted = _ALGORITHMS[value.get("kind") == DAGGER]
    (kind,) = (one for one in get_args(union) if one.__name__ == wanted)
    return _converter.structure(value, kind)


def _names(value: Any, _: type) -> tuple[str, ...]:
    """A list of names, or one string with commas between them."""
    return tuple(listed(value))


_converter = cattrs.Converter(forbid_extra_keys=True)
_converter.register_structure_hook(int, _whole_number)
_converter.register_structure_hook(bool, _truth)
_converter.register_structure_hook_func(lambda kind: kind == tuple[str, ...], _names)
_converter.register_structure_hook_func(_is_algorithm, _algorithm)
