"""``policy.safetensors``: a trained policy's weights and its run's config, in one file.

What an agent needs to act, without what it learns with (value head, optimiser, environments).
Nothing in it is ever unpickled.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from needlehoop.envs.observer import vectors
from needlehoop.learning.agent import Agent
from needlehoop.learning.encoder import Fold
from needlehoop.learning.job import Job
from needlehoop.learning.networks import Gaussian, Trunk
from needlehoop.learning.precision import convolution_dtype
from needlehoop.runs.files import POLICY, write_whole
from needlehoop.runs.older import completed
from needlehoop.runs.reading import UnreadableError, check_plain, parse_json

_CONFIG = "config"
"""Under this name the file's metadata have the run's config, as JSON."""


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


def build_actor(job: Job, device: torch.device) -> Actor:
    """An untrained policy of a job; needs no simulator."""
    env, heads = job.env, job.algo.network
    dtype = convolution_dtype(job.precision, device)
    size = env.image_size
    images = {name: torch.Size((c, size, size)) for name, c in env.image_channels.items()}
    trunk = Trunk(images, vectors(env.obs), job.encoder, heads, dtype)
    head = Gaussian(heads.hidden, env.episode.action_size, heads.sigma)
    return Actor(Fold(job.encoder.stem), trunk, head, len(images)).to(device)


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


def read_config(path: Path) -> dict[str, Any]:
    """The run's config that a ``policy.safetensors`` carries.

    Raises:
        ValueError: no such file, or a damaged or foreign one.
    """
    with _reading(path), safe_open(path, framework="pt") as file:
        found = file.metadata() or {}
    try:
        return completed(parse_json(found[_CONFIG]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} holds no policy of needlehoop: no config in it") from error


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_config``."""
    with _reading(path):
        state = load_file(path)
    have = {(name, one.shape) for name, one in state.items()}
    odd = have ^ {(name, one.shape) for name, one in actor.state_dict().items()}
    if odd:
        names = sorted({name for name, _ in odd})
        raise ValueError(f"{path} does not fit its config: {names[0]} and {len(names) - 1} others")
    actor.load_state_dict(state)


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
