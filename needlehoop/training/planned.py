"""The runs that a sweep is to make, composed by Hydra as the sweep itself composes them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any

from hydra import initialize_config_dir

from needlehoop.config import composing, strict
from needlehoop.runs.files import listed
from needlehoop.runs.shipped import CONF
from needlehoop.study.data.records import Place
from needlehoop.training.sweep import identity, label_of, parted

_NO_SETTINGS = {"cams", "views", "study", "results", "label"}
"""Keys that say nothing of how a run is trained, or that its place says."""


def planned(words: Sequence[str]) -> dict[Place, dict[str, str]]:
    """The runs of an experiment, or of a sweep that is spelt out, with settings they are to have.

    Args:
        words: as ``train.py -m`` takes them: ``+experiment=table2``, ``cams=[a,b],[c]``,
            ``reward=human,sparse``, ``seed=0,1,2``, ``conf_dir=mine``. They replace what an
            experiment sweeps over. ``experiment=`` needs no plus.

    Returns:
        By run, its ``steps``, what is typed, and what else differs from a training by the same
        algorithm for which nothing is typed; as ``Record.settings`` has them.

    Raises:
        ValueError: a word that ``train.py`` would refuse, or no cameras.
    """
    given = [f"+{word}" if word.startswith("experiment=") else word for word in words]
    # Under -m a comma list is a sweep.
    prepared, _ = composing.prepare(["-m", *given])
    place = [word for word in prepared if word.startswith("hydra.searchpath=")]
    typed = [word for word in prepared if word not in ("-m", *place)]

    @cache
    def compose(*chosen: str) -> Mapping[str, Any]:
        return composing.compose_here([*place, *chosen], "config")

    found: dict[Place, dict[str, str]] = {}
    with initialize_config_dir(str(CONF), version_base="1.3"):
        params = composing.swept([*place, *(one for one in typed if _key(one) == "experiment")])
        runs, swept = parted([*(f"{key}={value}" for key, value in params.items()), *typed])
        seeds = [strict.structure(seed, strict.Seed, "seed") for seed in swept]
        cams = [_cams(run) for run in runs]
        # Composing takes a tenth of a second, and cameras change no other setting.
        known = compose(f"cams=[{','.join(dict.fromkeys(chain(*cams)))}]")["cams"]
        for run, seen in zip(runs, cams, strict=True):
            if not {*seen} <= {*known}:
                # A name that stands for several cameras, such as stereo.
                seen = compose(f"cams=[{','.join(seen)}]")["cams"]
            values = dict(compose(*(one for one in run if _key(one) != "cams")))
            values["cams"] = seen or values["cams"]
            values["label"] = label_of(values, typed, params, run)
            own = identity(values, run)
            if not own["cameras"]:
                raise ValueError("cams: give experiment=… or cams=…, such as cams=[dep_front]")
            usual = _typed_settings(compose(*(one for one in run if _key(one) == "algo")))
            asked = {"steps", *map(_key, run)}
            settings = {
                key: text
                for key, text in _typed_settings(values).items()
                if not _NO_SETTINGS & {*key.split(".")}
                # Which reward it has is said by the place.
                and (key in asked or (usual.get(key) != text and not key.startswith("reward.")))
            }
            for seed in seeds or [own["seed"]]:
                found[Place(own["cameras"], own["reward"], seed)] = settings
    return dict(sorted(found.items()))


def _key(word: str) -> str:
    return word.lstrip("+").partition("=")[0]


def _cams(run: Iterable[str]) -> list[str]:
    """The cameras of a run's ``cams=[a,b]``; none where it has no such word."""
    (text,) = [word.partition("=")[2] for word in run if _key(word) == "cams"] or [""]
    names = text.strip("[]'")
    return listed(names) if names else []


def _typed_settings(values: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Settings as they are typed on the command line, by names such as ``algo.gamma``."""
    found: dict[str, str] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        inner = isinstance(value, Mapping)
        found |= _typed_settings(value, f"{name}.") if inner else {name: _typed(value)}
    return found


def _typed(value: Any) -> str:
    """A value as Hydra takes it."""
    if isinstance(value, list):
        return f"[{','.join(map(_typed, value))}]"
    return json.dumps(value) if value is None or isinstance(value, bool) else str(value)
