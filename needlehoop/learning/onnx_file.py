"""A trained policy as an ONNX file, for those who have no torch."""

from __future__ import annotations

import json
import logging
import warnings
from importlib import import_module

import torch
from torch import Tensor, nn

from needlehoop.learning.agent import Actor
from needlehoop.learning.weights import Senses

PRECISION = "fp32"
"""What the policy computes in: bfloat16 is what few runtimes have on a CPU."""


class _Clamped(nn.Module):
    """A policy whose action is one: within [-1, 1]."""

    def __init__(self, actor: Actor):
        super().__init__()
        self.actor = actor

    def forward(self, *observed: Tensor) -> Tensor:
        return self.actor(*observed).clamp(-1.0, 1.0)


def onnx_bytes(senses: Senses, actor: Actor) -> bytes:
    """The content of an ONNX file of a policy. Extra ``onnx``.

    Its inputs are the run's cameras, uint8 ``(n, c, h, w)``, then ``proprio``, ``signals``
    and ``told`` where it had them, float32 ``(n, length)``; its output is ``action``, float32
    ``(n, action_size)``. Under ``needlehoop`` its metadata have the run's environment.

    Args:
        actor: its policy, on the CPU, in ``PRECISION``.

    Raises:
        RuntimeError: the exporter is not installed, or does not take the policy.
    """
    try:
        for package in ("onnx", "onnxscript"):
            import_module(package)
    except ImportError as error:
        raise RuntimeError(
            f"what=policy needs {error.name}; install it with: pip install 'needlehoop[onnx]'"
        ) from error
    size = senses.image_size
    images = {
        name: torch.zeros(2, c, size, size, dtype=torch.uint8)
        for name, c in senses.channels.items()
    }
    example = {**images, **{name: torch.zeros(2, n) for name, n in senses.vectors.items()}}
    batch = torch.export.Dim("n")
    # It would speak of torchvision and of its own parts.
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
    facts = {"cams": [*senses.channels], "image_size": size, "episode": senses.control}
    program.model.metadata_props["needlehoop"] = json.dumps(facts)
    return program.model_proto.SerializeToString()
