"""``policy.safetensors``: a trained policy's weights and its run's config, in one file.

What an agent needs to act, without what it learns with (value head, optimiser, environments).
Nothing in it is unpickled, and of its config only what ``Senses`` names is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from needlehoop.config import strict
from needlehoop.envs.observer import vectors
from needlehoop.envs.settings import ImageSize, Observations
from needlehoop.learning.agent import Agent
from needlehoop.learning.encoder import EncoderConfig, Fold
from needlehoop.learning.job import Job
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk
from needlehoop.learning.precision import convolution_dtype
from needlehoop.runs.files import POLICY, write_whole
from needlehoop.runs.reading import UnreadableError, check_plain, parse_json
from needlehoop.scene.cameras import Rendering, parse_cameras
from needlehoop.task.episode import CONTROLS

_CONFIG = "config"
"""Under this name the file's metadata have the run's config, as JSON."""

_DTYPES = {torch.float32: ("F32", "BF16"), torch.float64: ("F64",), torch.int64: ("I64",)}
"""Types of numbers that a file may hold, by the policy's own."""


@dataclass(frozen=True)
class Senses:
    """What a policy sees, and its networks: all of a run's config that a policy needs."""

    cams: tuple[str, ...]
    channels: Mapping[str, int]
    """Of each camera's image, stacked frames included."""
    image_size: int
    obs: Observations
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    precision: str

    @classmethod
    def of(cls, job: Job) -> Senses:
        """Those of a job."""
        env, network = job.env, job.algo.network
        seen = (env.cams, env.image_channels, env.image_size, env.obs)
        return cls(*seen, job.encoder, network, env.episode.control, job.precision)

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Senses:
        """Those of a run's config, of which nothing else is looked at.

        Raises:
            ValueError: a key is missing or wrong.
        """
        found = strict.structure(_picked(values), _Picked, "")
        cameras = parse_cameras(found.cams, found.views, found.renderings)
        stacked = found.obs.frame_stack
        channels = {c.name: found.renderings[c.rendering].channels * stacked for c in cameras}
        if found.control not in CONTROLS:
            valid = ", ".join(CONTROLS)
            raise ValueError(f"episode.control: {found.control!r} is unknown; choose from {valid}")
        return cls(
            found.cams,
            channels,
            found.image_size,
            found.obs,
            found.encoder,
            found.network,
            found.control,
            found.precision,
        )

    @property
    def actions(self) -> int:
        """Length of the action."""
        return CONTROLS[self.control]


@dataclass(frozen=True)
class _Picked:
    """The part of a config that ``Senses.read`` looks at."""

    cams: tuple[str, ...]
    views: tuple[str, ...]
    renderings: Mapping[str, Rendering]
    image_size: ImageSize
    obs: Observations
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    precision: str


def _picked(values: Mapping[str, Any]) -> dict[str, Any]:
    """Raises ``ValueError`` for a config that lacks a key or a group."""
    try:
        own = {key: values[key] for key in ("cams", "renderings", "image_size", "obs", "encoder")}
        own |= {"views": [*values["views"]], "precision": values["precision"]}
        return {
            **own,
            "network": values["algo"]["network"],
            "control": values["episode"]["control"],
        }
    except (KeyError, TypeError) as error:
        raise ValueError(f"config: {error} is missing or no group") from error


class Actor(nn.Module):
    """The policy's part of an agent: observations to the mean action, on plain tensors.

    Args:
        fold: of images.
        trunk: of all observations.
        head: the Gaussian on it.
        images: how many of the observations are images; they come first.
    """

    def __init__(self, fold: Fold, trunk: Trunk, head: Gaussian, images: int):
        super().__init__()
        self._images = images
        self.fold, self.trunk, self.head = fold, trunk, head

    def forward(self, *observed: Tensor) -> Tensor:
        """The mean ``(..., action_size)`` of images ``(..., c, h, w)`` uint8, then vectors."""
        images, vectors = observed[: self._images], observed[self._images :]
        loc, _ = self.head(self.trunk(*(self.fold(image) for image in images), *vectors))
        return loc


def actor_of(agent: Agent) -> Actor:
    """An agent's policy: the same modules, so what is loaded into one is in the other."""
    modules = [*agent.modules()]
    # A value function with a trunk of its own has the second.
    trunk = next(module for module in modules if isinstance(module, Trunk))
    head = next(module for module in modules if isinstance(module, Gaussian))
    folds = [module for module in modules if isinstance(module, Fold)]
    return Actor(folds[0] if folds else Fold(1), trunk, head, len(trunk.encoders))


def build_actor(senses: Senses, device: torch.device) -> Actor:
    """An untrained policy; needs no simulator."""
    heads, size = senses.network, senses.image_size
    dtype = convolution_dtype(senses.precision, device)
    images = {name: torch.Size((c, size, size)) for name, c in senses.channels.items()}
    trunk = Trunk(images, vectors(senses.obs), senses.encoder, heads, dtype)
    head = Gaussian(heads.hidden, senses.actions, heads.sigma)
    return Actor(Fold(senses.encoder.stem), trunk, head, len(images))


def write_weights(folder: Path, actor: Actor, values: Mapping[str, Any], dtype: str) -> None:
    """Write ``policy.safetensors`` into a run's folder, whole or not at all.

    Args:
        folder: of the run.
        actor: its trained policy.
        values: its config.
        dtype: of the weights, by name, as in ``Job``; the vectors' statistics stay as they are.
    """
    wanted = getattr(torch, dtype)
    kept = {
        name: (one.to(wanted) if one.dtype == torch.float32 else one).cpu().contiguous()
        for name, one in actor.state_dict().items()
    }
    write_whole(folder / POLICY, save(kept, {_CONFIG: json.dumps(values)}))


def read_senses(path: Path) -> Senses:
    """What the policy of a ``policy.safetensors`` sees, by the config that it carries.

    Raises:
        ValueError: no such file, or a damaged or foreign one.
    """
    with _reading(path), safe_open(path, framework="pt") as file:
        found = file.metadata() or {}
    try:
        values = parse_json(found[_CONFIG])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds no policy of needlehoop: no config in it") from error
    try:
        return Senses.read(values)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_actor(path: Path, senses: Senses, device: torch.device) -> Actor:
    """The trained policy of a file; errors as in ``read_senses``."""
    # On no device: what the config describes costs no memory until the file is known to hold it.
    with torch.device("meta"):
        # Of bfloat16 there is no automatic casting on no device; shapes are the same.
        described = build_actor(replace(senses, precision="fp32"), torch.device("meta"))
    check_weights(path, described)
    actor = build_actor(senses, device)
    read_weights(path, actor)
    return actor.to(device)


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_senses``."""
    check_weights(path, actor)
    with _reading(path):
        state = load_file(path)
    for name, one in state.items():
        if not bool(torch.isfinite(one).all()):
            raise ValueError(f"{path}: {name} has numbers that are not finite")
    actor.load_state_dict(state)


def check_weights(path: Path, actor: Actor) -> None:
    """Check a file's names, shapes and types against a policy's, before any weight is read.

    Raises:
        ValueError: they are not the policy's.
    """
    with _reading(path), safe_open(path, framework="pt") as file:
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


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        check_plain(path)
        yield
    except UnreadableError as error:
        raise ValueError(f"{path} {error}") from error
    except FileNotFoundError as error:
        raise ValueError(f"{path}: no such file") from error
    except SafetensorError as error:
        raise ValueError(f"{path} is damaged: {error}") from error
