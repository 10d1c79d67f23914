"""Buffers, and going on with them, of each collector and each method of training."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from needlehoop.config import composing
from needlehoop.learning.collecting import MakeEnv, replayed
from needlehoop.learning.encoder import Fold
from needlehoop.learning.job import CollectorConfig, Job, typed_job
from needlehoop.learning.learner import Learner

SMALL = [
    *("cams=[dep_front,seg_side]", "image_size=32", "num_envs=5", "algo.horizon=8", "steps=160"),
    *("algo.minibatch=16", "algo.network.hidden=16", "episode.max_steps=6", "engine.threads=1"),
    *("obs.proprio=true", "obs.frame_stack=2", "disturb=severe", "disturb.ramp=0.5"),
]
"""Four buffers of 40 steps, of a training with everything that has a state."""

METHODS = {
    "ppo": ["algo.epochs=1"],
    "dagger": ["algo=dagger", "algo.minibatches=2", "algo.picture_shift=1", "algo.memory=100"],
    "sac": ["algo=sac", "algo.minibatches=2", "algo.memory=100"],
}
COLLECTORS = {"single": ["collector=single"], "processes": ["collector.workers=2"]}
CLOCKS = {"seconds_collect", "seconds_update"}


def job_of(*words: str) -> Job:
    method = [word for word in words if word.startswith("algo=")]
    rest = [word for word in words if not word.startswith("algo=")]
    return typed_job(composing.compose([*method, *SMALL, *rest], "job"))


def learnt(job: Job, updates: int | None = None, state: Any = None) -> tuple[Any, ...]:
    """What is logged of each buffer with its sum, the state afterwards, and the weights."""
    learner = Learner(job, state)
    logged = []
    for buffer, losses in learner:
        logged.append(said_of(buffer, losses))
        if learner.done_updates == updates:
            break
    kept, weights = saved(learner), weights_of(learner)
    learner.close()
    return logged, kept, weights


def said_of(buffer, losses) -> str:
    numbers = {name: value for name, value in losses.items() if name not in CLOCKS}
    return str({**numbers, "seen": float(buffer["next", "reward"].double().sum())})


def saved(learner: Learner) -> bytes:
    file = io.BytesIO()
    torch.save(learner.state_dict(), file)
    return file.getvalue()


def weights_of(learner: Learner) -> dict[str, torch.Tensor]:
    return {name: one.clone() for name, one in learner.agent.state_dict().items()}


@pytest.fixture(scope="module")
def by_two() -> SimpleNamespace:
    """A training whose environments are in two other processes."""
    learner = Learner(job_of("collector.workers=2", *METHODS["sac"]))
    logged, buffers, state = [], [], b""
    for buffer, losses in learner:
        logged.append(said_of(buffer, losses))
        buffers.append(buffer.clone())
        if learner.done_updates == 2:
            state = saved(learner)
    weights = weights_of(learner)
    learner.close()
    return SimpleNamespace(logged=logged, buffers=buffers, state=state, weights=weights)


@pytest.mark.parametrize(
    ("method", "collector"),
    [
        *((method, "single") for method in METHODS),
        *(pytest.param(method, "processes", marks=pytest.mark.full) for method in METHODS),
    ],
)
def test_a_seed_gives_the_same_bits_again_and_after_a_stop(method, collector):
    job = job_of(*METHODS[method], *COLLECTORS[collector])
    logged, _, weights = learnt(job)
    begun, state, _ = learnt(job, updates=2)
    assert begun == logged[:2]
    # Through a file, as a checkpoint goes.
    rest, _, again = learnt(job, state=torch.load(io.BytesIO(state), weights_only=True))
    assert rest == logged[2:]
    assert [name for name in weights if not torch.equal(weights[name], again[name])] == []


def test_a_machine_with_other_cores_goes_on_with_as_many_workers(by_two):
    state = torch.load(io.BytesIO(by_two.state), weights_only=True)
    rest, _, again = learnt(job_of(*METHODS["sac"]), state=state)
    assert rest == by_two.logged[2:]
    assert all(torch.equal(one, again[name]) for name, one in by_two.weights.items())


def test_images_are_folded_where_they_are_made_and_resets_renew_those_that_began():
    job = job_of()
    env: Any = MakeEnv(job, 0, 5, 1)()
    fold, now = Fold(job.encoder.stem), env.reset()
    ended = 0
    for _ in range(8):
        now["action"] = 2 * torch.rand(5, 5) - 1
        both, now = env.step_and_maybe_reset(now)
        done = both["next", "done"].flatten()
        ended += int(done.sum())
        for name, seen in env.base_env._observer.pixels.items():
            assert torch.equal(now["pixels", name], fold(seen))
            same = now["pixels", name] == both["next", "pixels", name]
            assert bool(same[~done].all())
    assert ended > 5


def test_buffers_are_replayed_from_their_actions(by_two):
    job = job_of(*METHODS["sac"])
    again = replayed(job, torch.stack([buffer["action"] for buffer in by_two.buffers]))
    for buffer, repeated in zip(by_two.buffers, again, strict=True):
        for key in (("pixels", "seg_side"), "proprio", ("next", "pixels", "dep_front")):
            assert torch.equal(buffer[key], repeated[key]), key
        assert torch.equal(buffer["next", "reward"], repeated["next", "reward"])


def test_the_environment_is_one_of_torchrls():
    job = job_of(*METHODS["dagger"])
    check_env_specs(MakeEnv(job, 0, 5, 1)())


@pytest.mark.parametrize(
    ("kind", "workers", "num_envs", "cores", "parts"),
    [
        ("processes", None, 80, 16, [20] * 4),
        ("processes", 3, 80, 2, [27, 27, 26]),
        ("processes", 9, 4, 2, [1] * 4),
        ("single", 3, 80, 2, [80]),
    ],
)
def test_environments_are_shared_among_workers(kind, workers, num_envs, cores, parts):
    assert CollectorConfig(kind, workers).parts(num_envs, cores) == parts
