"""``policy.safetensors``, ``best.safetensors``: a policy's weights and its run's config, in a file.

It holds what an agent needs to act, and not what it learns with (value head, optimiser,
environments). Nothing in it is unpickled.

Its metadata, of JSON: ``senses``, what the policy sees and does; ``config`` of its run; and of the
best policy the ``evaluation`` that it was the best at.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Range
from needlehoop.learning.agent import Actor, build_actor
from needlehoop.learning.policy_spec import PolicySpec
from needlehoop.runs.files import write_whole
from needlehoop.runs.reading import parse_json

Steps = Annotated[int, Range(0, 10**15)]

_DTYPES = {torch.float32: ("F32", "BF16"), torch.float64: ("F64",), torch.int64: ("I64",)}
"""Types of numbers that a file may hold, by the policy's own."""


def write_weights(
    path: Path,
    spec: PolicySpec,
    actor: Actor,
    values: Mapping[str, Any],
    dtype: str,
    evaluation: Mapping[str, Any] | None = None,
) -> None:
    """Write a policy's file, whole or not at all.

    Args:
        values: the run's config, for the record; it is not read back.
        dtype: of the weights, by name, as in ``Job``; the vectors' statistics stay as they are.
        evaluation: of the best policy, for the record: its row of ``evaluations.csv``.
    """
    state = _as(getattr(torch, dtype), actor.state_dict())
    kept = {name: one.cpu().contiguous() for name, one in state.items()}
    notes = {"senses": asdict(spec), "config": values}
    notes |= {} if evaluation is None else {"evaluation": evaluation}
    write_whole(path, save(kept, {name: json.dumps(note) for name, note in notes.items()}))


def read_step(path: Path) -> int | None:
    """Steps before the evaluation that a best policy's file notes; errors as in ``read_spec``."""
    found = _note(path, "evaluation") or {}
    return strict.structure(found.get("step"), Steps | None, f"{path}: step")


def read_spec(path: Path) -> PolicySpec:
    """What the policy of a ``policy.safetensors`` sees and does.

    Raises:
        ValueError: no such file, or a damaged or foreign one.
    """
    values = _note(path, "senses")
    if values is None:
        raise ValueError(f"{path} holds no policy of needlehoop: it does not say what it sees")
    try:
        return strict.structure(values, PolicySpec)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_actor(path: Path, spec: PolicySpec, device: torch.device) -> Actor:
    """The trained policy of a file; errors as in ``read_spec``."""
    # Built without memory first: a config may describe more than the file holds. The meta device
    # has no automatic casting to bfloat16; the shapes are the same.
    with torch.device("meta"):
        check_weights(path, build_actor(replace(spec, precision="fp32"), torch.device("meta")))
    actor = build_actor(spec, device)
    read_weights(path, actor)
    return actor.to(device)


def _as(dtype: torch.dtype, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights in another type; the vectors' statistics stay as they are."""
    return {n: one.to(dtype) if one.dtype == torch.float32 else one for n, one in state.items()}


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_spec``."""
    check_weights(path, actor)
    with _opened(path):
        state = load_file(path)
    for name, one in state.items():
        if not bool(torch.isfinite(one).all()):
            raise ValueError(f"{path}: {name} has numbers that are not finite")
    actor.load_state_dict(state)


def check_weights(path: Path, actor: Actor) -> None:
    """Raises ``ValueError`` for names, shapes or types that are not a policy's; reads no weight."""
    with _opened(path) as file:
        slices = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118
        have = {name: (tuple(s.get_shape()), s.get_dtype()) for name, s in slices.items()}
    odd = []
    for name, one in actor.state_dict().items():
        shape, dtype = have.pop(name, ((), ""))
        if shape != tuple(one.shape) or dtype not in _DTYPES[one.dtype]:
            odd.append(name)
    odd += sorted(have)
    if odd:
        more = f" and {len(odd) - 1} others" if odd[1:] else ""
        raise ValueError(f"{path} does not fit its config: {odd[0]}{more}")


def _note(path: Path, name: str) -> Any:
    """What a file's metadata has under a name; ``None`` for nothing, or nothing that is JSON."""
    with _opened(path) as file:
        found = file.metadata() or {}
    try:
        return parse_json(found[name])
    except (KeyError, TypeError, ValueError):
        return None


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        with safe_open(path, framework="pt") as file:
            yield file
    except FileNotFoundError as error:
        raise ValueError(f"{path}: no such file") from error
    except SafetensorError as error:
        raise ValueError(f"{path} is damaged: {error}") from error
