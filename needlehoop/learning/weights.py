"""``policy.safetensors``, ``best.safetensors``: a policy's weights and its run's config, in a file.

It holds what an agent needs to act, and not what it learns with (value head, optimiser,
environments). Nothing in it is unpickled.

Its metadata, of JSON: ``senses``, what the policy sees and does; ``config`` of its run; and, of the
best policy, its ``evaluation``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save

from needlehoop.config import strict
from needlehoop.config.strict import Range
from needlehoop.learning.networks import Actor, PolicySpec
from needlehoop.runs.files import write_whole

Steps = Annotated[int, Range(0, 10**15)]


def write_weights(
    path: Path,
    spec: PolicySpec,
    actor: Actor,
    values: Mapping[str, Any],
    dtype: str,
    evaluation: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy's file, whole or not at all.

    ``values``, the run's config, and ``evaluation``, the best policy's row of ``evaluations.csv``,
    are for the record. The vectors' statistics keep their type, whatever the weights' ``dtype``.
    """
    kept = {
        name: one.to(getattr(torch, dtype)) if one.dtype == torch.float32 else one
        for name, one in actor.state_dict().items()
    }
    notes = {"senses": asdict(spec), "config": values, "evaluation": evaluation}
    metadata = {name: json.dumps(note) for name, note in notes.items() if note is not None}
    content = save({name: one.cpu().contiguous() for name, one in kept.items()}, metadata)
    write_whole(path, content)


def read_step(path: Path) -> int | None:
    """Steps before the evaluation that a best policy's file notes; errors as in ``read_spec``."""
    found = _note(path, "evaluation") or {}
    return strict.structure(found.get("step"), Steps | None, f"{path}: step")


def read_spec(path: Path) -> PolicySpec:
    """What a file's policy sees and does; ``ValueError`` for no, a damaged or a foreign file."""
    values = _note(path, "senses")
    if values is None:
        raise ValueError(f"{path} holds no policy of needlehoop: it does not say what it sees")
    try:
        return strict.structure(values, PolicySpec)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_actor(path: Path, spec: PolicySpec, device: torch.device) -> Actor:
    """The trained policy of a file; errors as in ``read_spec``."""
    actor = Actor(spec, spec.trunk(device))
    read_weights(path, actor)
    return actor.to(device)


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_spec``."""
    with _opened(path):
        state = load_file(path)
    with fitting(str(path)):
        actor.load_state_dict(state)


@contextmanager
def fitting(what: str) -> Iterator[None]:
    """Raises ``ValueError`` in one line where a state does not fit what it is loaded into."""
    try:
        yield
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        said = str(error).splitlines()[-1].strip()
        raise ValueError(f"{what} does not fit its config: {said}") from error


def _note(path: Path, name: str) -> Any:
    """What a file's metadata has under a name, if anything."""
    with _opened(path) as file:
        return json.loads((file.metadata() or {}).get(name, "null"))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with safe_open(path, framework="pt") as file:
            yield file
    except FileNotFoundError as error:
        raise ValueError(f"{path}: no such file") from error
    except (OSError, SafetensorError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error
