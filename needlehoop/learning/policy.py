"""A policy outside its training: its file, as a function of an observation, and as ONNX.

``policy.safetensors`` and ``best.safetensors`` hold what an agent needs to act, and not what it
learns with (value head, optimiser, environments). Nothing in them is unpickled. Their metadata, of
JSON: ``senses``, what the policy sees and does; ``config`` of its run; and, of the best policy, its
``evaluation``.
"""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from needlehoop.config import strict
from needlehoop.learning.networks import Actor, PolicySpec
from needlehoop.runs.files import write_whole
from needlehoop.runs.machine import import_extra

PRECISION = "fp32"
"""What a policy in an ONNX file computes in, because few runtimes have bfloat16 on a CPU."""


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
        name: weight.to(getattr(torch, dtype)) if weight.dtype == torch.float32 else weight
        for name, weight in actor.state_dict().items()
    }
    notes = {"senses": asdict(spec), "config": values, "evaluation": evaluation}
    metadata = {name: json.dumps(note) for name, note in notes.items() if note is not None}
    content = save({name: weight.cpu().contiguous() for name, weight in kept.items()}, metadata)
    write_whole(path, content)


def read_step(path: Path) -> int | None:
    """Steps before the evaluation that a best policy's file notes; errors as in ``read_spec``."""
    note = _note(path, "evaluation") or {}
    return strict.structure(note.get("step"), strict.Number | None, f"{path}: step")


def read_spec(path: Path) -> PolicySpec:
    """What a file's policy sees and does; ``ValueError`` if it is missing, damaged or foreign."""
    values = _note(path, "senses")
    if values is None:
        raise ValueError(f"{path} holds no policy of needlehoop: it does not say what it sees")
    try:
        return strict.structure(values, PolicySpec)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_actor(path: Path, spec: PolicySpec, device: torch.device) -> Actor:
    """The trained policy of a file; errors as in ``read_spec``."""
    # First without memory: a stranger's file may name networks that no machine could hold.
    plain = replace(spec, precision=PRECISION)
    with torch.device("meta"):
        shapes = Actor(plain, plain.trunk(torch.device("cpu")))
    state = _state(path)
    with fitting(str(path)):
        shapes.load_state_dict({name: one.to("meta") for name, one in state.items()})
    actor = Actor(spec, spec.trunk(device))
    with fitting(str(path)):
        actor.load_state_dict(state)
    return actor.to(device)


def read_weights(path: Path, actor: Actor) -> None:
    """Put a file's weights into a policy of its run; errors as in ``read_spec``."""
    state = _state(path)
    with fitting(str(path)):
        actor.load_state_dict(state)


def _state(path: Path) -> dict[str, Tensor]:
    with _opened(path):
        return load_file(path)


@contextmanager
def fitting(what: str) -> Iterator[None]:
    """Raises ``ValueError`` in one line where a state does not fit what it is loaded into."""
    try:
        yield
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        # Torch names every weight that is missing or too many.
        reason = shorten(str(error).splitlines()[-1], 160, placeholder=" …")
        raise ValueError(f"{what} does not fit its config: {reason}") from error


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


class Policy:
    """``policy(observation)``: the mean action, in [-1, 1]; ``origin``: which it is, in words.

    An observation maps the run's cameras, and ``proprio``, ``signals`` and ``privileged_facts``
    where it had them, to numpy arrays or torch tensors with any leading dimensions. Images are
    uint8: ``(..., h, w, c)`` as from Gymnasium and dm_control, or ``(..., c, h, w)`` as from
    TorchRL, whose TensorDict may be given as it is. The action ``(..., action_size)`` is float32:
    numpy for numpy, torch for torch.
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
        inputs = dict(observation.items())
        inputs |= inputs.pop("pixels", {}).items()
        needed = (*self._images, *self._vectors)
        if missing := sorted({*needed} - {*inputs}):
            raise ValueError(
                f"observation: {', '.join(missing)} missing; the policy sees {', '.join(needed)}"
            )
        is_torch = isinstance(inputs[needed[0]], Tensor)
        seen = []
        for name in needed:
            value = inputs[name]
            # A copy, because torch warns of arrays that may not be written to.
            value = value if isinstance(value, Tensor) else torch.from_numpy(np.array(value))
            fits = self._image if name in self._images else self._vector
            seen.append(fits(name, value).to(self._device))
        action = self._actor(*seen)
        return action.to(inputs[needed[0]].device) if is_torch else action.cpu().numpy()

    def _image(self, name: str, image: Tensor) -> Tensor:
        """Channels first."""
        channels, height, width = first = tuple(self._images[name])
        last = height, width, channels
        if image.dtype != torch.uint8 or image.shape[-3:] not in (first, last):
            raise ValueError(
                f"{name}: {image.dtype} {tuple(image.shape)}; expected uint8, its last dimensions"
                f" {first} or {last}"
            )
        return image if image.shape[-3:] == first else image.movedim(-1, -3)

    def _vector(self, name: str, vector: Tensor) -> Tensor:
        length = self._vectors[name]
        if vector.shape[-1:] != (length,):
            raise ValueError(f"{name}: shape {tuple(vector.shape)}; expected (…, {length})")
        return vector.float()


def onnx_bytes(spec: PolicySpec, actor: Actor) -> bytes:
    """The content of an ONNX file of a policy on the CPU, in ``PRECISION``. Extra ``onnx``.

    Its inputs are the run's cameras, uint8 ``(n, c, h, w)``, then ``proprio``, ``signals``
    and ``privileged_facts`` where it had them, float32 ``(n, length)``; its output is ``action``,
    float32 ``(n, action_size)``. Under ``needlehoop`` its metadata have the run's environment.
    """
    import_extra("onnxscript", "what=policy", "onnx")
    example = {
        **{name: torch.zeros(2, *s, dtype=torch.uint8) for name, s in spec.images.items()},
        **{name: torch.zeros(2, length) for name, length in spec.vectors.items()},
    }
    batch = torch.export.Dim("n")
    # The exporter logs and warns of its own parts.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        program: Any = torch.onnx.export(
            actor.eval(),
            tuple(example.values()),
            input_names=[*example],
            output_names=["action"],
            dynamic_shapes={"observed": tuple({0: batch} for _ in example)},
            dynamo=True,
            verbose=False,
        )
    facts = {"cams": [*spec.channels], "image_size": spec.image_size, "episode": spec.control}
    program.model.metadata_props["needlehoop"] = json.dumps(facts)
    return program.model_proto.SerializeToString()
