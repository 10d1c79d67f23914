"""Sweeps: the runs that one is to make, and what became of its jobs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from needlehoop.runs.files import DAGGER, EXPERT, OUTCOME, PPO, SWEEPS, labelled, name_of, seen
from needlehoop.runs.reading import UnreadableError, read_json, read_yaml
from needlehoop.runs.shipped import CONF
from needlehoop.study.data.contents import checked
from needlehoop.study.data.paper import HUMAN
from needlehoop.study.data.records import LeftOut, Place, typed_settings

_KEYS = ("experiment", "algo", "cams", "reward", "seed")
_OWN = "conf_dir"
_NO_SETTINGS = ("defaults", "hydra", "study", "results", "views")
"""Keys of an experiment's file that say nothing of how a run is trained."""

_COMMA = re.compile(r",(?![^\[\]]*\])")
"""Between the choices of a sweep, and not within a list."""


@dataclass(frozen=True)
class _Note:
    """What a sweep's job leaves."""

    study: str
    cameras: str
    reward: str
    seed: int
    outcome: str
    error: str | None = None


def read_job_ends(study: Path) -> tuple[dict[Place, tuple[float, str | None]], list[LeftOut]]:
    """The newest end of each run that sweeps have tried for a study, which may have no folder yet.

    Returns:
        By run, when it ended (Unix time, s) and why it failed, if it did; then the notes that
        cannot be read.
    """
    root = study.resolve().parent / SWEEPS
    found: dict[Place, tuple[float, str | None]] = {}
    left_out: list[LeftOut] = []
    # The newest comes last.
    for when, path in sorted((one.lstat().st_mtime, one) for one in root.glob(f"*/*/{OUTCOME}")):
        try:
            note: _Note = checked(_Note, read_json(path))
        except UnreadableError as error:
            left_out.append(LeftOut(Path("..") / path.relative_to(root.parent), str(error)))
            continue
        if note.study == study.resolve().name:
            found[Place(note.cameras, note.reward, note.seed)] = when, note.error
    return found, left_out


def planned(words: Sequence[str]) -> dict[Place, dict[str, str]]:
    """The runs of an experiment, or of a sweep that is spelt out, with settings they are to have.

    Args:
        words: as ``train.py`` takes them: ``experiment=table2``, ``cams=[a,b],[c]``,
            ``reward=human,sparse``, ``seed=0,1,2``, ``algo=dagger``, ``steps=500_000``,
            ``algo.learning_rate=1e-4,3e-4``, ``conf_dir=mine``. They replace what an experiment
            sweeps over; by default the reward is human and the seed 0.

    Returns:
        By run, the values of keys, as ``Record.settings`` has them; ``steps`` is one of them.

    Raises:
        ValueError: a word that is no key and value, an unknown experiment, camera or reward, or no
            cameras.
    """
    pairs = [_pair(word) for word in words]
    folders = [CONF]
    for path in (value for key, value in pairs if key == _OWN):
        folders.append(Path(path).expanduser())
        if not folders[-1].is_dir():
            raise ValueError(f"{_OWN}: {path!r} is no folder")
    given = {key: value for key, value in pairs if key != _OWN}
    own, views = {"cams": "", "reward": HUMAN, "seed": "0"}, list[str]()
    if "experiment" in given:
        params, views = _experiment(given.pop("experiment"), folders)
        own |= params
    own |= given
    algo = own.pop("algo", PPO)
    taught = algo == DAGGER
    seeds = _whole("seed", own.pop("seed").split(","), "seed=0,1,2")
    cams, rewards, models = own.pop("cams"), own.pop("reward"), own.pop("model", None)
    if models is not None and not taught:
        named = [model.strip().rpartition(".") for model in models.split(",")]
        chosen = [(name.split("+"), reward) for name, _, reward in named]
    else:
        chosen = [*product(_camera_sets(cams), [one.strip() for one in rewards.split(",")])]
    _check(chosen, folders, views)
    own.setdefault("steps", _steps(algo))
    given_label = own.pop("label", "")
    for key in _NO_SETTINGS:
        own.pop(key, None)
    choices = {key: [_written(one) for one in _COMMA.split(text)] for key, text in own.items()}
    swept = {key for key, values in choices.items() if len(values) > 1}
    _whole("steps", choices["steps"], "steps=500_000")
    found = {}
    for (cameras, reward), seed, values in product(chosen, seeds, product(*choices.values())):
        settings = dict(zip(choices, values, strict=True))
        differs = name_of((key, settings[key]) for key in swept)
        label = "+".join(filter(None, (given_label, differs))) or None
        place = Place(seen(cameras), labelled(EXPERT if taught else reward, label), seed)
        # A run's config has an option's values, not its name.
        found[place] = {k: v for k, v in settings.items() if not (CONF / k).is_dir()}
    return dict(sorted(found.items()))


def _pair(word: str) -> tuple[str, str]:
    key, found, value = word.partition("=")
    key = key.lstrip("+")
    known = {*_KEYS, _OWN, "model", *read_yaml(CONF / "job.yaml"), *read_yaml(CONF / "env.yaml")}
    known |= {one.name for one in CONF.iterdir() if one.is_dir()} - {"defaults"}
    understood = found and key.partition(".")[0] in known
    named = key in _KEYS or not (CONF / key).is_dir() or _COMMA.search(value)
    if not understood or not named:
        why = ": a run's files do not name it" if understood else ""
        raise ValueError(
            f"{word!r} is not understood{why}; choose from {', '.join(_KEYS)}, or any other key of"
            " a training with a =, such as steps=500_000"
        )
    return key, value


def _experiment(name: str, folders: Sequence[Path]) -> tuple[dict[str, str], list[str]]:
    """What an experiment's file sweeps over with the values that it sets, and its own views."""
    files = {
        option: read_yaml(folder / f"experiment/{option}.yaml")
        for folder in folders
        for option in _options("experiment", [folder])
    }
    # Not every experiment is a sweep.
    valid = {option: values for option, values in files.items() if "hydra" in values}
    if name not in valid:
        raise ValueError(f"experiment: {name!r} is unknown; choose from {', '.join(valid)}")
    own = valid[name]
    chosen = {key: value for key, value in own.items() if key not in _NO_SETTINGS}
    swept = own["hydra"]["sweeper"]["params"]
    params = {**typed_settings(chosen), **{key.lstrip("+"): str(swept[key]) for key in swept}}
    return params, list(own.get("views", ()))


def _steps(algo: str) -> str:
    """Steps of a run where none are typed: the algorithm's own, or those of every training."""
    file = CONF / f"algo/{algo}.yaml"
    own = read_yaml(file) if file.is_file() else {}
    return str(own.get("steps", read_yaml(CONF / "job.yaml")["steps"]))


def _written(text: str) -> str:
    """A value as it stands in a run's settings: ``1e-4`` is 0.0001, and ``500_000`` 500000."""
    for kind in (int, float):
        try:
            return str(kind(text))
        except ValueError:
            continue
    return text.strip()


def _camera_sets(text: str) -> list[list[str]]:
    """``[a,b],[c]`` as two camera sets; a bare list is one of single cameras."""
    found = re.findall(r"\[([^\[\]]*)\]|([^,\[\]\s]+)", text)
    return [[name.strip() for name in (listed or single).split(",")] for listed, single in found]


def _whole(key: str, texts: Sequence[str], example: str) -> list[int]:
    for text in texts:
        if not text.strip().isdecimal():
            raise ValueError(f"{key}: {text!r} is not a whole number; give such as {example}")
    return [int(text) for text in texts]


def _check(
    pairs: Sequence[tuple[Sequence[str], str]], folders: Sequence[Path], views: Iterable[str]
) -> None:
    """Checks that cameras and rewards exist; a typing error would count as missing for ever."""
    known = [*_options("view", folders), *views]
    valid = {
        "cams": [f"{r}_{v}" for r, v in product(_options("rendering", folders), known)],
        # The human reward has a file for each task.
        "reward": sorted([*_options("reward", folders), HUMAN]),
    }
    if not pairs:
        raise ValueError("cams: give experiment=… or cams=…, such as cams=[dep_front,seg_side]")
    for cams, reward in pairs:
        for key, value in (*(("cams", camera) for camera in cams), ("reward", reward)):
            if value not in valid[key]:
                choices = ", ".join(valid[key])
                raise ValueError(f"{key}: {value!r} is unknown; choose from {choices}")


def _options(group: str, folders: Sequence[Path]) -> list[str]:
    return sorted(file.stem for folder in folders for file in (folder / group).glob("*.yaml"))
