"""A run's bits do not depend on the machine's threads."""

from __future__ import annotations

import pytest
import torch

from needlehoop.config import composing
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import Learner

SMALL = [
    "cams=[dep_front,seg_side]",
    "steps=96",
    "num_envs=6",
    "algo.horizon=8",
    "algo.minibatch=24",
    "image_size=32",
    "episode.max_steps=6",
]


def learnt(*overrides: str) -> dict[str, torch.Tensor]:
    learner = Learner(typed_job(composing.compose([*SMALL, *overrides], "job")))
    for _ in learner:
        pass
    return learner.agent.state_dict()


@pytest.mark.parametrize(
    "uneven",
    [
        [],
        # 7 environments in shards of 3, 3 and 1; minibatches of 20, 20 and 16 in 7, 7, 6 and so on.
        [
            "num_envs=7",
            "algo.shards=3",
            "algo.minibatch=20",
            "obs.proprio=true",
            "obs.frame_stack=2",
        ],
    ],
    ids=["even", "uneven"],
)
def test_the_same_seed_learns_the_same_at_any_thread_count(uneven):
    one, other = (learnt(f"engine.threads={threads}", *uneven) for threads in (1, 3))
    assert [name for name in one if not torch.equal(one[name], other[name])] == []


def test_the_same_seed_imitates_the_same_at_any_thread_count():
    # In words of its own: the algorithm's file brings its own number of steps.
    words = ["algo=dagger", "algo.minibatches=4", "algo.handover=0.5"]
    one, other = (learnt(f"engine.threads={threads}", *words) for threads in (1, 3))
    assert [name for name in one if not torch.equal(one[name], other[name])] == []
