"""A trained policy for others: as a function of an observation, and as an ONNX file."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from needlehoop.learning.networks import Actor, PolicySpec

PRECISION = "fp32"
"""What a policy in an ONNX file computes in, because few runtimes have bfloat16 on a CPU."""


class Policy:
    """``policy(observation)``: the mean action, in [-1, 1]; ``origin``: which it is, in words.

    An observation maps the run's cameras, and ``proprio``, ``signals`` and ``told`` where it
    had them, to numpy arrays or torch tensors with any leading dimensions. Images are uint8:
    ``(..., h, w, c)`` as from Gymnasium and dm_control, or ``(..., c, h, w)`` as from TorchRL,
    whose TensorDict may be given as it is. The action ``(..., action_size)`` is float32: numpy
    for numpy, torch for torch.
    """

    def __init__(self, spec: PolicySpec, actor: Actor, origin: str):
        self.origin = origin
        self._actor, self._device = actor.eval(), next(actor.parameters()).device
        self._images, self._vectors = spec.images, spec.vectors

    def __repr__(self) -> str:
        return f"Policy({self.origin})"

    @torch.no_grad()
    def __call__(self, observation: Mapping[str, Any]) -> Any:
        """The action; ``ValueError`` for what is missing, or of another shape or type."""
        given = dict(observation.items())
        given |= given.pop("pixels", {}).items()
        needed = (*self._images, *self._vectors)
        if missing := sorted({*needed} - {*given}):
            raise ValueError(
                f"observation: {', '.join(missing)} missing; the policy sees {', '.join(needed)}"
            )
        first = given[needed[0]]
        # A copy, because torch warns of arrays that may not be written to.
        seen = {
            name: one if isinstance(one, Tensor) else torch.from_numpy(np.array(one))
            for name, one in given.items()
            if name in needed
        }
        images = [_image(name, seen[name], shape) for name, shape in self._images.items()]
        vectors = [_vector(name, seen[name], n) for name, n in self._vectors.items()]
        found = self._actor(*(one.to(self._device) for one in (*images, *vectors))).clamp(-1.0, 1.0)
        return found.to(first.device) if isinstance(first, Tensor) else found.cpu().numpy()


def _image(name: str, image: Tensor, first: torch.Size) -> Tensor:
    """Channels first."""
    last = (*first[1:], first[0])
    if image.dtype != torch.uint8 or image.shape[-3:] not in (first, last):
        valid = " or ".join(f"(…, {', '.join(map(str, one))})" for one in (first, last))
        raise ValueError(f"{name}: {image.dtype} {tuple(image.shape)}; expected uint8 {valid}")
    return image if image.shape[-3:] == first else image.movedim(-1, -3)


def _vector(name: str, vector: Tensor, length: int) -> Tensor:
    if vector.shape[-1:] != (length,):
        raise ValueError(f"{name}: shape {tuple(vector.shape)}; expected (…, {length})")
    return vector.float()


class _Clamped(nn.Module):
    """A policy whose actions are clamped to [-1, 1]."""

    def __init__(self, actor: Actor):
        super().__init__()
        self.actor = actor

    def forward(self, *observed: Tensor) -> Tensor:
        return self.actor(*observed).clamp(-1.0, 1.0)


def onnx_bytes(spec: PolicySpec, actor: Actor) -> bytes:
    """The content of an ONNX file of a policy on the CPU, in ``PRECISION``. Extra ``onnx``.

    Its inputs are the run's cameras, uint8 ``(n, c, h, w)``, then ``proprio``, ``signals``
    and ``told`` where it had them, float32 ``(n, length)``; its output is ``action``, float32
    ``(n, action_size)``. Under ``needlehoop`` its metadata have the run's environment.
    """
    try:
        import_module("onnxscript")
    except ImportError as error:
        raise RuntimeError(
            f"what=policy needs {error.name}; install it with: pip install 'needlehoop[onnx]'"
        ) from error
    example = {
        **{name: torch.zeros(2, *s, dtype=torch.uint8) for name, s in spec.images.items()},
        **{name: torch.zeros(2, length) for name, length in spec.vectors.items()},
    }
    batch = torch.export.Dim("n")
    # The exporter logs and warns of its own parts.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            _Clamped(actor).eval(),
            tuple(example.values()),
            input_names=[*example],
            output_names=["action"],
            dynamic_shapes={"observed": tuple({0: batch} for _ in example)},
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    facts = {"cams": [*spec.channels], "image_size": spec.image_size, "episode": spec.control}
    program.model.metadata_props["needlehoop"] = json.dumps(facts)
    return program.model_proto.SerializeToString()
