"""Imitation: who flies, what is labelled, what is learnt, and going on."""

from __future__ import annotations

import torch
from tiny_runs import learner

from needlehoop.learning.transforms import LEARNER

SMALL = [
    "algo=dagger",
    "cams=[seg_side]",
    "image_size=32",
    "num_envs=4",
    "algo.horizon=8",
    "algo.minibatch=16",
    "algo.minibatches=6",
    "algo.memory=200",
    "episode.max_steps=6",
    "steps=128",
    "engine.threads=1",
]
"""Four buffers of 32 steps."""


def test_the_expert_labels_what_it_flies_and_what_the_learner_flies():
    taught = learner(*SMALL, "algo.noise=0", "algo.handover=0.5")
    turns = [(buffer.clone(), losses) for buffer, losses in taught]
    first, losses = turns[0]
    assert losses["share"] < 0.3
    is_learner = first[LEARNER].squeeze(-1)
    # Episodes of six steps: the first are all the expert's.
    assert not is_learner[:, :6].any()
    assert torch.equal(first["action"][~is_learner], first["label"][~is_learner])
    # Those of the expert's do not count as the learner's.
    assert not first["next", "done"][~is_learner].any()
    last, losses = turns[-1]
    assert losses["share"] == 1.0
    assert last[LEARNER].all()
    assert not torch.equal(last["action"], last["label"])
    assert last["next", "done"].sum() >= 4
    assert last["label"].abs().max() <= 1.0


def test_the_policy_comes_to_do_what_the_expert_does():
    """By more than chance: without learning, the error of buffers differs by 0.02 at most."""
    taught = learner(
        *SMALL,
        *("cams=[]", "obs=signals", "num_envs=16", "algo.horizon=20", "steps=2560"),
        *("algo.minibatches=40", "algo.minibatch=64", "algo.memory=2560", "episode.max_steps=40"),
    )
    turns = [losses for _, losses in taught]
    assert turns[-1]["error"] < 0.6 * turns[0]["error"]
    # The deviation becomes what is left of the error.
    assert turns[-1]["sigma"] < turns[0]["sigma"]


def test_noise_leads_the_expert_astray_and_the_value_function_is_left_as_it_is():
    taught = learner(*SMALL, "algo.noise=0.8")
    before = {name: one.clone() for name, one in taught.agent.state_dict().items()}
    buffer, _ = next(iter(taught))
    assert not torch.equal(buffer["action"], buffer["label"])
    assert buffer["label"].abs().max() <= 1.0
    changed = {n for n, one in taught.agent.state_dict().items() if not torch.equal(one, before[n])}
    value = {name for name in before if name.startswith("value.")}
    assert value
    assert changed
    assert not changed & value


def test_an_image_is_moved_whenever_it_is_learnt_from_and_only_then():
    # The expert flies the first buffer; images are kept as they were seen.
    (first, losses), (other, told_shifted) = (
        next(iter(learner(*SMALL, f"algo.picture_shift={most}"))) for most in (0, 2)
    )
    key = ("pixels", "seg_side")
    assert torch.equal(first[key], other[key])
    assert losses["loss_imitation"] != told_shifted["loss_imitation"]
