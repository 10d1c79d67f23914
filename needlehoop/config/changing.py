"""A run's settings with some of them changed by words such as ``task=wide episode.max_steps=80``.

Any key of an environment may be changed, and any option of its groups chosen, except what the
agent's networks were made for.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any

from hydra import initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from needlehoop.config import composing, options
from needlehoop.config.strict import shown
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF

_SEEN = {"cams", "image_size", "obs"}
_NO_CONDITIONS = {*_SEEN, "cameras", "num_envs", "seed", "task_dir"}
"""Keys of an environment that stay as the run has them."""

_NO_EFFECT = ("engine.kind", "engine.threads", "picture.")
"""Keys, and beginnings of keys, that may be typed and change nothing that an agent does."""


def parted(words: Iterable[str], command: str) -> tuple[list[str], list[str]]:
    """Words for a command, whose keys ``conf/<command>.yaml`` has, and those that change a run."""
    overrides, keys = list(words), _keys(command)
    command_words = [word for word in overrides if _top(word) in keys]
    return command_words, [word for word in overrides if word not in command_words]


def changed(
    recorded: Mapping[str, Any], words: Iterable[str], command: str | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """A run's settings after the words are applied, and those among them that changed.

    A group's option replaces the group; another word sets one value. Where a key is unknown, the
    ``command``'s keys are named beside the others.

    Returns all settings, whose values are not checked yet; and the new values by their whole key,
    ``episode.grasp``. Raises ``ValueError`` for an unknown key or option, or a key that may not be
    changed.
    """
    overrides, before = list(words), deepcopy(dict(recorded))
    tops = check(overrides, recorded, command)
    if not tops:
        return before, {}
    if newer := tops - {*recorded}:
        # A run from before there was such a setting has it as it is by default.
        default = composing.compose((), "env")
        before |= {top: default[top] for top in newer}

    task = recorded["task"]["name"]
    prepared, folders = composing.prepare(overrides, task, recorded.get("task_dir"))
    place = [word for word in prepared if word.startswith("hydra.searchpath=")]
    rest = [word for word in prepared if word not in place]
    groups = {one.name for folder in (CONF, *folders) for one in folder.iterdir() if one.is_dir()}
    replaced = {word.lstrip("+").partition("=")[0] for word in rest} & groups
    # An option is composed with the values typed for it: it may lack some, as reward=file does.
    chosen = [word for word in rest if _top(word) in replaced]
    values = deepcopy(before)
    if chosen:
        # A reward's YAML refers to the cameras, and the run's may be of a conf_dir not typed now.
        seen = [f"++cameras.{name}=null" for name in recorded["cams"] if "reward" in tops]
        with initialize_config_dir(str(CONF), version_base="1.3"):
            composed = composing.compose_here([*place, *chosen, *seen], "env")
        values |= {group: composed[group] for group in replaced}
    if values["task"].get("name") != task:
        variants = ", ".join(options.variants(task, [CONF, *folders]))
        raise ValueError(f"task: the run's is {task}; choose from {variants}")
    for word in rest:
        if word not in chosen:
            _set(values, word)
    old = dict(_leaves(before))
    new = _leaves({top: values[top] for top in tops})
    return values, {
        key: value
        for key, value in new
        if not key.startswith(_NO_EFFECT) and (key not in old or old[key] != value)
    }


def check(words: Iterable[str], recorded: Mapping[str, Any], command: str | None) -> set[str]:
    """The first parts of the words' keys; ``ValueError`` for one that may not be changed."""
    tops = {_top(word) for word in words} - {"conf_dir"}
    valid = {"views", "renderings", *_keys("env")} - _NO_CONDITIONS
    for top in sorted(tops - valid):
        if top in _SEEN:
            raise ValueError(
                f"{top}: the agent's networks take what the run sees, {shown(recorded.get(top))},"
                f" and nothing else; choose from {', '.join(sorted(valid))}"
            )
        known = {*(_keys(command) if command else []), *valid}
        raise ValueError(f"{top}: unknown key; choose from {', '.join(sorted(known))}")
    return tops


def _set(values: dict[str, Any], word: str) -> None:
    """Set one value by a word, in place."""
    with composing.explained("env"):
        (override,) = OverridesParser.create().parse_overrides([word])
    *above, last = override.key_or_group.split(".")
    here: Any = values
    for key in above:
        here = here.setdefault(key, {})
        if not isinstance(here, dict):
            raise ValueError(f"{override.key_or_group}: {key} has no keys")
    here[last] = override.value()


def setting(word: str) -> tuple[str, str]:
    """A word's key, and its value as Hydra writes it."""
    (parsed,) = OverridesParser.create().parse_overrides([word])
    return parsed.key_or_group, parsed.get_value_element_as_str()


def _top(word: str) -> str:
    """The first part of a word's key."""
    return re.split(r"[=.]", word.lstrip("+"), maxsplit=1)[0]


def _keys(config: str) -> list[str]:
    """The keys and groups that a config of ``conf/`` names itself."""
    settings = read_yaml(CONF / f"{config}.yaml")
    listed: list[Any] = settings.pop("defaults", [])
    return [*settings, *(key for entry in listed if isinstance(entry, Mapping) for key in entry)]


def _leaves(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value
