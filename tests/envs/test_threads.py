"""A run's bits do not depend on the machine's threads."""

from __future__ import annotations

import pytest
import torch

from needlehoop import config
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


def learnt(*overrides: str) -> tuple[dict[str, torch.Tensor], dict[str, float]]:
    learner = Learner(config.job(config.compose([*SMALL, *overrides], "job")))
    told = [losses for _, losses in learner]
    return learner.agent.state_dict(), told[0]


def test_the_same_seed_learns_the_same_at_any_thread_count():
    (one, _), (three, _) = learnt("engine.threads=1"), learnt("engine.threads=3")
    assert all(torch.equal(one[name], three[name]) for name in one)


def test_shards_only_round_differently():
    (whole, one), (split, other) = (
        learnt("steps=48", f"algo.shards={shards}", "precision=fp32") for shards in (1, 3)
    )
    assert other["loss_value"] == pytest.approx(one["loss_value"], rel=1e-4)
    assert all(torch.allclose(whole[name], split[name], atol=1e-4) for name in whole)
