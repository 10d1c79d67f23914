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
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from needlehoop.config import strict
from needlehoop.config.strict import Range, shown
from needlehoop.envs.observer import vectors
from needlehoop.envs.settings import ImageSize
from needlehoop.learning.agent import Actor
from needlehoop.learning.encoder import EncoderConfig, Fold, convolution_dtype
from needlehoop.learning.job import Job
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk
from needlehoop.runs.files import write_whole
from needlehoop.runs.reading import check_plain, named, parse_json

Steps = Annotated[int, Range(0, 10**15)]

_DTYPES = {torch.float32: ("F32", "BF16"), torch.float64: ("F64",), torch.int64: ("I64",)}
"""Types of numbers that a file may hold, by the policy's own."""


@dataclass(frozen=True)
class Senses:
    """What a policy sees and does, and its networks: all that is needed to run it."""

    channels: Mapping[str, Annotated[int, Range(1, 1024)]]
    """Of each camera's image, stacked frames included; in the order in which they are read."""
    image_size: ImageSize
    vectors: Mapping[str, Annotated[int, Range(1, 100_000)]]
    """Length of each other observation, in the order in which they are read."""
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    """How its actions move the robot, see ``episode.control``."""
    actions: Annotated[int, Range(1, 1000)]
    """Length of the action."""
    precision: str

    def __post_init__(self) -> None:
        # They name modules of the networks.
        for name in (*self.channels, *self.vectors):
            if not name.isidentifier():
                raise ValueError(f"senses: {name!r} is no name of a camera or vector")

    @property
    def images(self) -> dict[str, torch.Size]:
        """The shape ``(c, h, w)`` of each camera's image."""
        size = self.image_size
        return {name: torch.Size((c, size, size)) for name, c in self.channels.items()}

    @classmethod
    def of(cls, job: Job) -> Senses:
        """Those of a job."""
        env, rules = job.env, job.env.episode
        seen = (env.image_channels, env.image_size, vectors(env.definition, env.obs))
        return cls(*seen, job.encoder, job.network, rules.control, rules.action_size, job.precision)


def check_same(have: Senses, want: Senses, what: str) -> None:
    """Raises ``ValueError``, which begins with ``what``, for networks of something else."""
    for key in Senses.__dataclass_fields__:
        own, other = getattr(have, key), getattr(want, key)
        if own != other:
            raise ValueError(
                f"{what}: the agent's networks were made for {key} {shown(own)}, and this is"
                f" {shown(other)}"
            )


def build_actor(senses: Senses, device: torch.device) -> Actor:
    """An untrained policy; needs no simulator."""
    heads, dtype = senses.network, convolution_dtype(senses.precision, device)
    trunk = Trunk(senses.images, senses.vectors, senses.encoder, heads, dtype)
    head = Gaussian(heads.hidden, senses.actions, heads.sigma)
    return Actor(Fold(senses.encoder.stem), trunk, head)


def write_weights(
    path: Path,
    senses: Senses,
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
    notes = {"senses": asdict(senses), "config": values}
    notes |= {} if evaluation is None else {"evaluation": evaluation}
    write_whole(path, save(kept, {name: json.dumps(note) for name, note in notes.items()}))


def read_step(path: Path) -> int | None:
    """Steps before the evaluation that a best policy's file notes; errors as in ``read_senses``."""
    found = _note(path, "evaluation") or {}
    return strict.structure(found.get("step"), Steps | None, f"{path}: step")


def read_senses(path: Path) -> Senses:
    """What the policy of a ``policy.safetensors`` sees and does.

    Raises:
        ValueError: no such file, or a damaged or foreign one.
    """
    values = _note(path, "senses")
    if values is None:
        raise ValueError(f"{path} holds no policy of needlehoop: it does not say what it sees")
    try:
        return strict.structure(values, Senses)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_actor(path: Path, senses: Senses, device: torch.device) -> Actor:
    """The trained policy of a file; errors as in ``read_senses``."""
    # Built without memory first: a config may describe more than the file holds. The meta device
    # has no automatic casting to bfloat16; the shapes are the same.
    with torch.device("meta"):
        check_weights(path, build_actor(replace(senses, precision="fp32"), torch.device("meta")))
    actor = build_actor(senses, device)
    read_weights(path, actor)
    return actor.to(device)


def as_bfloat16(path: Path) -> bytes:
    """A policy's file, float32 weights as bfloat16; errors as in ``read_senses``."""
    read_actor(path, read_senses(path), torch.device("cpu"))
    with _opened(path) as file:
        return save(_as(torch.bfloat16, load_file(path)), file.metadata())


def _as(dtype: torch.dtype, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights in another type; the vectors' statistics stay as they are."""
    return {n: one.to(dtype) if one.dtype == torch.float32 else one for n, one in state.items()}


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_senses``."""
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
        with named(path):
            check_plain(path)
        with safe_open(path, framework="pt") as file:
            yield file
    except FileNotFoundError as error:
        raise ValueError(f"{path}: no such file") from error
    except SafetensorError as error:
        raise ValueError(f"{path} is damaged: {error}") from error
