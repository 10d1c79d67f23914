"""Adam in blocks against torch's on whole weights."""

from __future__ import annotations

import io

import pytest
import torch
from torch import nn

from needlehoop.envs.workers import Workers
from needlehoop.learning import trainer
from needlehoop.learning.trainer import Optimizer

SHAPES = [(7, 5), (4, 3, 3, 3), (1,), (11,), (2, 40)]


def make(threads: int, rate: float = 1e-2) -> tuple[list[nn.Parameter], list, Optimizer]:
    torch.manual_seed(0)
    weights = [nn.Parameter(torch.randn(shape)) for shape in SHAPES]
    with torch.no_grad():
        weights[1].data = weights[1].contiguous(memory_format=torch.channels_last)
    copies = [nn.Parameter(weight.detach().bfloat16()) for weight in weights]
    made = Optimizer(weights, copies, Workers(threads))
    made.set_rate(rate)
    return weights, copies, made


def gradients(seed: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator) for shape in SHAPES]


def step(made: Optimizer, seed: int) -> None:
    whole = gradients(seed)
    made.step(lambda index, rows, out: out.copy_(whole[index][rows]))


@pytest.fixture(params=[20, 64, 10**6], autouse=True)
def block(request, monkeypatch):
    """Weights cut into rows, into a few blocks, and not at all."""
    monkeypatch.setattr(trainer, "_BLOCK", request.param)


def test_blocks_move_weights_as_adam_does():
    weights, copies, ours = make(threads=2)
    whole = [nn.Parameter(weight.detach().clone()) for weight in weights]
    theirs = torch.optim.Adam(whole, lr=1e-2)
    for seed in range(3):
        step(ours, seed)
        for weight, gradient in zip(whole, gradients(seed), strict=True):
            weight.grad = gradient
        theirs.step()
    for weight, copied, expected in zip(weights, copies, whole, strict=True):
        torch.testing.assert_close(weight, expected, rtol=1e-5, atol=1e-6)
        assert torch.equal(copied, weight.bfloat16())


def test_the_bits_are_those_of_any_number_of_threads():
    results = []
    for threads in (1, 2, 5):
        weights, _, ours = make(threads)
        for seed in range(3):
            step(ours, seed)
        results.append(weights)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_steps_after_a_restart_are_the_same_to_the_bit():
    weights, _, first = make(threads=1)
    step(first, 0)
    file = io.BytesIO()
    torch.save(first.state_dict(), file)
    file.seek(0)
    others, _, second = make(threads=1)
    with torch.no_grad():
        for other, weight in zip(others, weights, strict=True):
            other.copy_(weight)
    second.load_state_dict(torch.load(file, weights_only=True))
    for one in (first, second):
        step(one, 1)
    assert all(torch.equal(a, b) for a, b in zip(weights, others, strict=True))
