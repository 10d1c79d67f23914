"""Learning as a whole, on a task small enough for a test."""

from __future__ import annotations

import pytest

from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import Learner

REACH = [
    "obs=signals",
    "task=near",
    "reward.rate=1",
    "reward.grasp=2",
    "reward.lift=0",
    "steps=8000",
    "num_envs=40",
    "episode.max_steps=20",
    "algo.horizon=20",
    "algo.minibatch=80",
    "algo.epochs=8",
    "algo.learning_rate=1e-3",
    "engine.threads=1",
]
"""Ten buffers of one episode each: time to come near the needle, under a reward seen from afar."""


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 5])
def test_the_return_rises(seed):
    """By more than chance: without learning, such means differ by 0.03 at most."""
    learner = Learner(typed_job(composing.compose([*REACH, f"seed={seed}"], "job")))
    returns = [float(buffer["next", "potential"][:, -1].mean()) for buffer, _ in learner]
    first, second, *_, third_last, second_last, last = returns
    assert (third_last + second_last + last) / 3 > (first + second) / 2 + 0.08
