"""Sweeps: the runs that one is to make, and what became of its jobs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from needlehoop.runs.files import DAGGER, EXPERT, OUTCOME, SWEEPS, seen
from needlehoop.runs.reading import UnreadableError, read_json, read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data.paper import HUMAN
from needlehoop.study.data.records import LeftOut, Place

_KEYS = ("experiment", "algo", "cams", "reward", "seed")
_MODEL = "+model"
_NOTED = {"study": str, "cameras": str, "reward": str, "seed": int, "outcome": str}


@dataclass(frozen=True)
class JobEnd:
    """How a sweep's last try at a run ended."""

    when: float
    """Unix time, s."""
    error: str | None
    """Why it failed; ``None`` if it did not."""


def read_job_ends(study: Path) -> tuple[dict[Place, JobEnd], list[LeftOut]]:
    """The newest end of each run that sweeps have tried for a study.

    Args:
        study: the study's folder, whether it exists or not.

    Returns:
        Ends by run, and the notes that cannot be read.
    """
    root = study.resolve().parent / SWEEPS
    found: dict[Place, JobEnd] = {}
    left_out: list[LeftOut] = []
    for path in sorted(root.glob(f"*/*/{OUTCOME}")):
        try:
            note = _read_note(path)
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / path.relative_to(root.parent), str(error)))
            continue
        place = Place(note["cameras"], note["reward"], note["seed"])
        end = JobEnd(path.stat().st_mtime, note.get("error"))
        if note["study"] == study.resolve().name and (
            place not in found or found[place].when < end.when
        ):
            found[place] = end
    return found, left_out


def _read_note(path: Path) -> Mapping[str, Any]:
    note = read_json(path)
    kinds = {**_NOTED, **({"error": str} if "error" in note else {})}
    odd = [key for key, kind in kinds.items() if not isinstance(note.get(key), kind)]
    if odd:
        raise UnreadableError(f"has no usable {', '.join(odd)}")
    return note


def planned(words: Sequence[str]) -> list[Place]:
    """The runs of an experiment, or of a sweep that is spelt out.

    Args:
        words: as ``train.py`` takes them: ``experiment=table2``, ``cams=[a,b],[c]``,
            ``reward=human,sparse``, ``seed=0,1,2``, ``algo=dagger``. They replace what an
            experiment sweeps over; by default the reward is human and the seed 0.

    Raises:
        ValueError: another key, an unknown experiment, camera or reward, or no cameras.
    """
    given = dict(_pair(word) for word in words)
    own, views = {"cams": "", "reward": HUMAN, "seed": "0"}, ()
    if "experiment" in given:
        params, views = _experiment(given.pop("experiment"))
        own |= params
    own |= given
    taught = own.pop("algo", None) == DAGGER
    seeds = [_seed(text) for text in own["seed"].split(",")]
    if _MODEL in own and not taught:
        models = [model.strip().rpartition(".") for model in own[_MODEL].split(",")]
        pairs = [(name.split("+"), reward) for name, _, reward in models]
    else:
        rewards = [reward.strip() for reward in own["reward"].split(",")]
        pairs = [*product(_camera_sets(own["cams"]), rewards)]
    _check(pairs, views)
    return sorted(
        {
            Place(seen(cams), EXPERT if taught else reward, seed)
            for (cams, reward), seed in product(pairs, seeds)
        }
    )


def _pair(word: str) -> tuple[str, str]:
    key, _, value = word.partition("=")
    key = key.lstrip("+")
    if key not in _KEYS:
        raise ValueError(f"{word!r} is not understood; choose from {', '.join(_KEYS)}, with a =")
    return key, value


def _experiment(name: str) -> tuple[dict[str, str], Iterable[str]]:
    """What an experiment's file sweeps over, and its own views."""
    files = {
        option: read_yaml(CONF / f"experiment/{option}.yaml") for option in _options("experiment")
    }
    # Not every experiment is a sweep.
    valid = {
        option: (values["hydra"]["sweeper"]["params"], values.get("views", ()))
        for option, values in files.items()
        if "hydra" in values
    }
    if name not in valid:
        raise ValueError(f"experiment: {name!r} is unknown; choose from {', '.join(valid)}")
    return valid[name]


def _camera_sets(text: str) -> list[list[str]]:
    """``[a,b],[c]`` as two camera sets; a bare list is one of single cameras."""
    found = re.findall(r"\[([^\[\]]*)\]|([^,\[\]\s]+)", text)
    return [[name.strip() for name in (listed or single).split(",")] for listed, single in found]


def _seed(text: str) -> int:
    if not text.strip().isdecimal():
        raise ValueError(f"seed: {text!r} is not a whole number; give such as seed=0,1,2")
    return int(text)


def _check(pairs: Iterable[tuple[Sequence[str], str]], views: Iterable[str]) -> None:
    """Checks that cameras and rewards exist; a typing error would count as missing for ever."""
    cameras = [f"{r}_{v}" for r, v in product(_options("rendering"), [*_options("view"), *views])]
    named = [*pairs]
    if not named:
        raise ValueError("cams: give experiment=… or cams=…, such as cams=[dep_front,seg_side]")
    for cams, reward in named:
        for key, value, valid in (
            *(("cams", camera, cameras) for camera in cams),
            # The human reward has a file for each task.
            ("reward", reward, sorted([*_options("reward"), HUMAN])),
        ):
            if value not in valid:
                raise ValueError(f"{key}: {value!r} is unknown; choose from {', '.join(valid)}")


def _options(group: str) -> list[str]:
    return sorted(file.stem for file in (CONF / group).glob("*.yaml"))
