"""The runs that a sweep is to make, from the words that start it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product

from needlehoop.runs.files import DAGGER, EXPERT, seen
from needlehoop.runs.reading import read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data.records import Place

_KEYS = ("experiment", "algo", "cams", "reward", "seed")
_MODEL = "+model"


def planned(words: Sequence[str]) -> list[Place]:
    """The runs of an experiment, or of a sweep that is spelt out.

    Args:
        words: as ``train.py`` takes them: ``experiment=table2``, ``cams=[a,b],[c]``,
            ``reward=human,sparse``, ``seed=0,1,2``, ``algo=dagger``. What an experiment sweeps
            over may be given anew; by default the reward is human and the seed 0.

    Raises:
        ValueError: another key, an unknown experiment, camera or reward, or no cameras.
    """
    given = dict(_pair(word) for word in words)
    own = {"cams": "", "reward": "human", "seed": "0"}
    if "experiment" in given:
        own |= _experiment(given.pop("experiment"))
    own |= given
    if own.pop("algo", None) == DAGGER:
        return _taught(own)
    seeds = [_seed(text) for text in own["seed"].split(",")]
    if _MODEL in own:
        models = [model.strip().rpartition(".") for model in own[_MODEL].split(",")]
        pairs = [(name.split("+"), reward) for name, _, reward in models]
    else:
        rewards = [reward.strip() for reward in own["reward"].split(",")]
        pairs = list(product(_combinations(own["cams"]), rewards))
    _check(pairs)
    return sorted(Place(seen(cams), reward, seed) for (cams, reward), seed in product(pairs, seeds))


def _taught(own: Mapping[str, str]) -> list[Place]:
    """The runs of a sweep that an expert teaches."""
    seeds = [_seed(text) for text in own["seed"].split(",")]
    combinations = _combinations(own["cams"])
    _check([(cams, own["reward"]) for cams in combinations])
    return sorted(Place(seen(cams), EXPERT, seed) for cams in combinations for seed in seeds)


def _pair(word: str) -> tuple[str, str]:
    key, _, value = word.partition("=")
    key = key.lstrip("+")
    if key not in _KEYS:
        raise ValueError(f"{word!r} is not understood; choose from {', '.join(_KEYS)}, with a =")
    return key, value


def _experiment(name: str) -> dict[str, str]:
    """What an experiment's file sweeps over."""
    files = {
        option: read_yaml(CONF / f"experiment/{option}.yaml") for option in _options("experiment")
    }
    # Not every experiment is a sweep.
    valid = {
        option: values["hydra"]["sweeper"]["params"]
        for option, values in files.items()
        if "hydra" in values
    }
    if name not in valid:
        raise ValueError(f"experiment: {name!r} is unknown; choose from {', '.join(valid)}")
    return valid[name]


def _combinations(text: str) -> list[list[str]]:
    """``[a,b],[c]`` as two combinations; a bare list is one of single cameras."""
    found = re.findall(r"\[([^\[\]]*)\]|([^,\[\]\s]+)", text)
    return [[name.strip() for name in (listed or single).split(",")] for listed, single in found]


def _seed(text: str) -> int:
    if not text.strip().isdecimal():
        raise ValueError(f"seed: {text!r} is not a whole number; give such as seed=0,1,2")
    return int(text)


def _check(pairs: Iterable[tuple[Sequence[str], str]]) -> None:
    """That what is swept over is there; a typing error would count as missing for ever."""
    cameras = [f"{r}_{v}" for r, v in product(_options("rendering"), _options("view"))]
    named = [*pairs]
    if not named:
        raise ValueError("cams: give experiment=… or cams=…, such as cams=[dep_front,seg_side]")
    for cams, reward in named:
        for key, value, valid in (
            *(("cams", camera, cameras) for camera in cams),
            ("reward", reward, _options("reward")),
        ):
            if value not in valid:
                raise ValueError(f"{key}: {value!r} is unknown; choose from {', '.join(valid)}")


def _options(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))
