"""Training, evaluation and resuming on a GPU keep each tensor where it is used."""

from __future__ import annotations

import io

import pytest
import torch
from tiny_runs import composed
from virtual_cuda import CUDA, virtual_cuda

from needlehoop.learning.evaluate import evaluate
from needlehoop.learning.job import Job, checked_job
from needlehoop.learning.learner import Learner

SMALL = [
    *("device=cuda", "precision=fp32", "engine.threads=1", "cams=[dep_front,seg_side]"),
    *("num_envs=2", "algo.horizon=4", "algo.minibatch=4", "algo.network.hidden=8"),
    *("image_size=16", "encoder=resnet_s4d", "episode.max_steps=3", "obs.proprio=true"),
]

METHODS = {
    "ppo": ["algo.epochs=1", "steps=24"],
    "dagger": ["algo=dagger", "algo.minibatches=2", "algo.picture_shift=1", "steps=24"],
    "sac": ["algo=sac", "algo.minibatches=2", "algo.memory=50", "steps=24"],
}


def job_of(method: str) -> Job:
    return checked_job(composed(*SMALL, *METHODS[method]))


def test_what_mixes_the_devices_is_found():
    with virtual_cuda():
        here, there = torch.zeros(3), torch.zeros(3, device="cuda")
        assert (there + torch.ones(())).device == CUDA
        for mixed in (lambda: here + there, lambda: torch.stack((here, there)), there.numpy):
            with pytest.raises((RuntimeError, TypeError), match=r"device|cpu"):
                mixed()


@pytest.mark.parametrize("method", METHODS)
def test_a_gpu_trains_evaluates_and_goes_on(method):
    with virtual_cuda():
        job = job_of(method)
        learner = Learner(job)
        assert next(learner.agent.parameters()).device == CUDA
        trained = iter(learner)
        buffer, _ = next(trained)
        assert buffer.device == CUDA
        kept = io.BytesIO()
        torch.save(learner.state_dict(), kept)
        next(trained)
        assert evaluate(job.env, learner.agent, 2, sampled=True).summary()["episodes"] == 2
        kept.seek(0)
        resumed = Learner(job, torch.load(kept, map_location="cpu", weights_only=True))
        next(iter(resumed))
        for one, other in zip(learner.agent.parameters(), resumed.agent.parameters(), strict=True):
            assert one.device == other.device == CUDA
            assert torch.equal(one, other)
