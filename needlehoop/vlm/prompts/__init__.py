"""The texts that a model is shown, as files.

The texts of this folder are general. A task's own words and texts are put into them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from string import Template

from needlehoop.tasks.contract import Task, Telling

_INTO = ("scene", "signals")
"""Texts of a task that general ones take in."""


def telling_of(task: Task) -> Telling:
    """How a task is told.

    Raises:
        ValueError: it is told to no model.
    """
    if task.telling is None:
        raise ValueError(f"task {task.name}: no model can be asked about it; it has no telling")
    return task.telling


def fill(name: str, task: Task | None = None, /, **values: object) -> str:
    """The prompt ``<name>.txt`` with its ``$gaps`` filled.

    Args:
        name: of a general prompt, or of a task's own.
        task: whose words and texts are put in; ``None`` for a prompt that takes none.
        values: what fills the gaps.

    Raises:
        ValueError: gaps and values are not the same.
    """
    template = Template((_read(Path(__file__).parent) if task is None else texts(task))[name])
    gaps = set(template.get_identifiers())
    if gaps != set(values):
        odd = ", ".join(sorted(gaps ^ set(values)))
        raise ValueError(f"prompt {name}: {odd} missing or not asked for")
    return template.substitute({key: str(value) for key, value in values.items()}).strip()


def fill_told(name: str, task: Task, told: Mapping[str, object], **values: object) -> str:
    """A prompt that takes a task's text in; ``told`` may have more than its gaps."""
    gaps = Template(texts(task)[name]).get_identifiers()
    return fill(name, task, **{key: told[key] for key in gaps if key in told}, **values)


def texts(task: Task) -> dict[str, str]:
    """All prompts for a task by name, with ``$gaps``: the general ones, and its own.

    Raises:
        ValueError: a text of the task is missing, or is of no moment.
    """
    telling = telling_of(task)
    own = _read(telling.texts)
    odd = sorted({*_INTO} - {*own} | {*own} - {*_INTO, *telling.moments})
    if odd:
        raise ValueError(f"{telling.texts}: {odd[0]}.txt is missing or not asked for")
    words = {
        **{f"task_{name}": own.pop(name).strip() for name in _INTO},
        "goal": telling.goal,
        "done": telling.done,
    }
    general = _read(Path(__file__).parent).items()
    return {name: Template(text).safe_substitute(words) for name, text in general} | own


def questioned(task: Task) -> dict[str, str]:
    """The moments of which a question of its own asks what shows them best; what is so then."""
    own = texts(task)
    return {fact: so for fact, so in telling_of(task).moments.items() if fact in own}


def stages_of(task: Task) -> dict[str, str]:
    """The stages of an episode that are pictured, in order, and what is so in each."""
    telling = telling_of(task)
    return {"start": "an episode begins", **telling.moments, "goal": telling.goal}


def _read(folder: Path) -> dict[str, str]:
    return {file.stem: file.read_text(encoding="utf-8") for file in folder.glob("*.txt")}


def sha256(task: Task) -> str:
    """The hash of all prompts for a task and of the stages that they show, names included."""
    digest = hashlib.sha256()
    said = {f"{name}.txt": text for name, text in texts(task).items()} | stages_of(task)
    for name, text in sorted(said.items()):
        digest.update(f"{name}\0{text}\0".encode())
    return digest.hexdigest()
