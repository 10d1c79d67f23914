"""An agent that runs forward and backward in parts, which threads share."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from needlehoop.envs.workers import Workers
from needlehoop.learning.agent import Agent

_FEWEST = 8
"""Rows of a part, where there are as many: a part's fixed costs are those of about ten rows."""

Pair = tuple[Tensor, Tensor]


class _Part:
    """Some rows on their way through an encoder, or through what follows them; and back.

    Args:
        call: the way forward.
        weights: whose gradients are worked out part by part, by index.
        leaves: inputs whose gradients are wanted.
        grad: whether there will be a way back.
        running: notes of this thread: inputs and outputs of dense layers, by their weights' index.
    """

    def __init__(
        self,
        call: Callable[[], tuple[Tensor, ...]],
        weights: dict[int, nn.Parameter],
        leaves: list[Tensor],
        grad: bool,
        running: threading.local,
    ):
        self._weights, self._leaves = weights, leaves
        self._layers: dict[int, Pair] = {}
        running.layers = self._layers
        # Of the thread, like the notes.
        with torch.set_grad_enabled(grad):
            self.outputs = call()

    def back(self, slopes: Sequence[Tensor]) -> None:
        """Go back, from the gradients by the outputs.

        ``gradients`` are then those of the weights, ``slopes`` those by the leaves, and ``pairs``
        what the dense layers' follow from: their inputs, and the gradients by their outputs.
        """
        after = [output for _, output in self._layers.values()]
        inputs = [*self._weights.values(), *self._leaves, *after]
        found = iter(torch.autograd.grad(self.outputs, inputs, slopes))
        self.gradients = {weight: next(found) for weight in self._weights}
        self.slopes = [next(found) for _ in self._leaves]
        self.pairs = {weight: (x, next(found)) for weight, (x, _) in self._layers.items()}


class ParallelAgent:
    """Runs an agent forward and backward.

    Each encoder has parts of the rows, then what follows the encoders has. How rows are parted
    depends on their number alone, and so do all bits.

    Most weights are in dense layers, whose gradients are large however few the rows of a part.
    Writing them for every part and adding them up took as long as all convolutions; so a part
    leaves a layer's input and the gradient by its output, and the product is taken once.

    Args:
        agent: what runs. Its dense layers' weights are set not to ask for gradients.
        shards: parts of all encoders together, at least, and parts of the rest.
    """

    def __init__(self, agent: Agent, shards: int, workers: Workers):
        self.agent, self._shards, self._workers = agent, shards, workers
        self._images = sum(key[0] == "folded" for key in agent.seen_keys)
        places = {id(weight): index for index, weight in enumerate(agent.parameters())}
        self._running = threading.local()
        for module in agent.modules():
            if isinstance(module, nn.Linear):
                module.weight.requires_grad_(False)
                module.register_forward_hook(self._note(places[id(module.weight)]))
        asking = {places[id(one)]: one for one in agent.parameters() if one.requires_grad}
        own = [{places[id(one)] for one in encoder.parameters()} for encoder in agent.encoders]
        self._own = [{i: one for i, one in asking.items() if i in places} for places in own]
        self._rest = {i: one for i, one in asking.items() if not any(i in own_ for own_ in own)}
        self._forth: tuple[list[_Part], list[_Part]] = ([], [])
        self._parts: dict[int, list[Tensor]] = {}
        self._products: dict[int, Pair] = {}

    def outputs(self, seen: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """``Agent.outputs`` of rows, not to be gone back from."""
        return _joined(self._run(seen, slice(None), False)[1])

    def forward(self, seen: Sequence[Tensor], rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """``Agent.outputs`` of chosen rows, for ``backward``."""
        self._forth = self._run(seen, rows, True)
        return _joined(self._forth[1])

    def backward(self, slopes: Sequence[Tensor]) -> None:
        """Go back from the loss's gradients by the last forward's outputs."""
        encoded, concluded = self._forth
        self._workers.map(_Part.back, concluded, _split(slopes, concluded))
        by_feature = [
            torch.cat(parts) for parts in zip(*(p.slopes for p in concluded), strict=True)
        ]
        count = len(encoded) // max(1, len(by_feature))
        own = [
            part
            for i, slope in enumerate(by_feature)
            for part in _split([slope], encoded[i * count : (i + 1) * count])
        ]
        self._workers.map(_Part.back, encoded, own)
        self._parts, pairs = defaultdict(list), defaultdict(list)
        for part in (*encoded, *concluded):
            for index, gradient in part.gradients.items():
                self._parts[index].append(gradient)
            for index, pair in part.pairs.items():
                pairs[index].append(pair)
        joined = self._workers.map(_join, pairs.values())
        self._products = dict(zip(pairs, joined, strict=True))

    def write(self, weight: int, rows: slice, out: Tensor) -> None:
        """Write rows of a weight's gradient; its index is that among the agent's parameters."""
        if weight in self._products:
            given, slope = self._products[weight]
            out.copy_(slope[:, rows].t() @ given)
            return
        first, *others = self._parts[weight]
        out.copy_(first[rows])
        for other in others:
            out += other[rows]

    def _run(
        self, seen: Sequence[Tensor], chosen: Tensor | slice, grad: bool
    ) -> tuple[list[_Part], list[_Part]]:
        """The encoders' parts, encoder by encoder, and those of the rest."""
        encoders, images = self.agent.encoders, self._images
        total = len(chosen) if isinstance(chosen, Tensor) else len(seen[0])

        def pick(x: Tensor, rows: slice) -> Tensor:
            return x[rows] if isinstance(chosen, slice) else x.index_select(0, chosen[rows])

        def encode(which: int, rows: slice) -> _Part:
            image, own = pick(seen[which % images], rows), self._own[which]
            return _Part(lambda: (encoders[which](image),), own, [], grad, self._running)

        def conclude(rows: slice) -> _Part:
            leaves = [feature[rows].detach().requires_grad_(grad) for feature in features]
            rest = [pick(x, rows) for x in seen[images:]]
            call = partial(self.agent.conclude, leaves, rest)
            return _Part(call, self._rest, leaves, grad, self._running)

        parts = _slices(total, -(-self._shards // max(1, len(encoders))))
        order = [(which, rows) for which in range(len(encoders)) for rows in parts]
        encoded = self._workers.map(encode, *zip(*order, strict=True)) if order else []
        features = [
            _joined(encoded[at : at + len(parts)])[0] for at in range(0, len(encoded), len(parts))
        ]
        return encoded, self._workers.map(conclude, _slices(total, self._shards))

    def _note(self, weight: int) -> Any:
        def hook(_: nn.Module, given: tuple[Tensor, ...], output: Tensor) -> None:
            if output.requires_grad:
                self._running.layers[weight] = (given[0].detach(), output)

        return hook


def _join(pairs: list[Pair]) -> Pair:
    given, slopes = zip(*pairs, strict=True)
    return torch.cat(given), torch.cat(slopes)


def _joined(passes: Sequence[_Part]) -> Any:
    """Outputs of consecutive parts as one, without the way back."""
    pairs = zip(*(part.outputs for part in passes), strict=True)
    return tuple(torch.cat(parts).detach() for parts in pairs)


def _split(slopes: Sequence[Tensor], passes: Sequence[_Part]) -> list[tuple[Tensor, ...]]:
    """Gradients of all rows as those of each part."""
    sizes = [len(one.outputs[0]) for one in passes]
    return list(zip(*(slope.split(sizes) for slope in slopes), strict=True))


def _slices(count: int, parts: int) -> list[slice]:
    """Consecutive rows in at most so many parts, none smaller than it must be."""
    size = max(-(-count // parts), min(_FEWEST, count))
    return [slice(at, min(at + size, count)) for at in range(0, count, size)]
