"""``policy.safetensors``: a trained policy's weights and its run's config, in one file.

It holds what an agent needs to act, and not what it learns with (value head, optimiser,
environments). Nothing in it is unpickled. Only the keys of its config that ``Senses`` names are
read.
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

from needlehoop.config import strict
from needlehoop.envs.observer import vectors
from needlehoop.envs.settings import ImageSize, Observations
from needlehoop.learning.agent import Actor
from needlehoop.learning.encoder import EncoderConfig, Fold, convolution_dtype
from needlehoop.learning.job import Job
from needlehoop.learning.networks import Gaussian, HeadConfig, Trunk
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
    """What a policy sees, and its networks: the part of a run's config that a policy needs.

    Raises:
        ValueError: an unknown camera or control mode.
    """

    cams: tuple[str, ...]
    views: tuple[str, ...]
    """Names of those that the cameras choose from."""
    renderings: Mapping[str, Rendering]
    image_size: ImageSize
    obs: Observations
    encoder: EncoderConfig
    network: HeadConfig
    control: str
    precision: str

    def __post_init__(self) -> None:
        parse_cameras(self.cams, self.views, self.renderings)
        if self.control not in CONTROLS:
            valid = ", ".join(CONTROLS)
            raise ValueError(f"episode.control: {self.control!r} is unknown; choose from {valid}")

    @classmethod
    def of(cls, job: Job) -> Senses:
        """Those of a job."""
        env, network = job.env, job.algo.network
        seen = (env.cams, tuple(env.views), env.renderings, env.image_size, env.obs)
        return cls(*seen, job.encoder, network, env.episode.control, job.precision)

    @classmethod
    def read(cls, values: Mapping[str, Any]) -> Senses:
        """Those of a run's config; its other keys are ignored.

        Raises:
            ValueError: a key is missing or wrong.
        """
        own = ("cams", "renderings", "image_size", "obs", "encoder", "precision")
        try:
            picked = {
                **{key: values[key] for key in own},
                "views": [*values["views"]],
                "network": values["algo"]["network"],
                "control": values["episode"]["control"],
            }
        except (KeyError, TypeError) as error:
            raise ValueError(f"config: {error} is missing or no group") from error
        return strict.structure(picked, cls, "")

    @property
    def channels(self) -> dict[str, int]:
        """Of each camera's image, stacked frames included."""
        cameras = parse_cameras(self.cams, self.views, self.renderings)
        return {
            c.name: self.renderings[c.rendering].channels * self.obs.frame_stack for c in cameras
        }

    @property
    def actions(self) -> int:
        """Length of the action."""
        return CONTROLS[self.control]


def build_actor(senses: Senses, device: torch.device) -> Actor:
    """An untrained policy; needs no simulator."""
    heads, size = senses.network, senses.image_size
    dtype = convolution_dtype(senses.precision, device)
    images = {name: torch.Size((c, size, size)) for name, c in senses.channels.items()}
    trunk = Trunk(images, vectors(senses.obs), senses.encoder, heads, dtype)
    head = Gaussian(heads.hidden, senses.actions, heads.sigma)
    return Actor(Fold(senses.encoder.stem), trunk, head)


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
    # Built without memory first: a config may describe more than the file holds.
    with torch.device("meta"):
        # The meta device has no automatic casting to bfloat16. The shapes are the same.
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
