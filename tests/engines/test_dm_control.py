"""``engine=dm_control``: the contract by another road, bit for bit."""

from __future__ import annotations

import pytest
import torch

from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings
from needlehoop.tasks.needle_hoop.expert import Expert

CAMS = "cams=[dep_front,seg_side,rgb_wrist]"

KINDS = ("cpu", "dm_control")


def built(kind: str, *words: str):
    cams = [] if any("cams=" in word for word in words) else [CAMS]
    common = [*cams, "image_size=24", "num_envs=3", "seed=5", "engine.threads=1", f"engine={kind}"]
    return build(compose_settings([*common, *words]))


@pytest.mark.parametrize(
    "words",
    [
        ["psm=parallelogram"],
        ["psm=serial", "episode.grasp=friction"],
        ["task=reach"],
        ["task=peg_transfer"],
        ["task=handover", "cams=[dep_front,rgb_wrist_1,seg_wrist_2]"],
        pytest.param(["task=peg_transfer", "episode.grasp=friction"], marks=pytest.mark.full),
    ],
)
def test_both_engines_have_the_same_state_sensors_and_images(words):
    pairs = {kind: built(kind, *words, "episode.max_steps=20") for kind in KINDS}
    one, other = pairs.values()
    script = one.task.controllers["expert"](one.layout, one.episode)
    moment = one.reset()
    other.reset()
    over = torch.zeros(3, dtype=torch.bool)
    begun, resets = False, 0
    for step in range(30):
        # Begun anew one after the other, so that later they do not end together either.
        over = over | (torch.arange(3) == step)
        if bool(over.any()):
            resets += not bool(over.all())
            moment = one.reset(over)
            other.reset(over)
            ids = over.nonzero().flatten()
            few, few_again = one.images(ids), other.images(ids)
            assert all(torch.equal(few[name], few_again[name]) for name in few)
        action = script(moment.signals)
        moment, same = one.step(action), other.step(action)
        assert torch.equal(moment.reward, same.reward)
        assert torch.equal(one.engine.sensordata(), other.engine.sensordata())
        torch.testing.assert_close(one.engine.snapshot(), other.engine.snapshot(), rtol=0, atol=0)
        begun |= bool(moment.facts[one.task.phases[0].ends].any())
        over = moment.terminated | moment.truncated
        if step % 9 == 0:
            images, again = one.images(), other.images()
            assert all(torch.equal(images[name], again[name]) for name in images)
    assert begun
    assert resets > 1


@pytest.mark.parametrize(("first", "second"), [KINDS, KINDS[::-1], ("dm_control", "dm_control")])
def test_one_engine_goes_on_from_the_others_snapshot(first, second):
    one, other = built(first), built(second)
    script = Expert(one.layout, one.episode)
    moment = one.reset()
    for _ in range(14):
        moment = one.step(script(moment.signals))
    assert bool(moment.signals.grasped.any())
    # The other one has never been reset.
    other.restore(one.snapshot())
    assert torch.equal(one.engine.sensordata(), other.engine.sensordata())
    for _ in range(8):
        action = script(moment.signals)
        moment = one.step(action)
        other.step(action)
        torch.testing.assert_close(one.engine.snapshot(), other.engine.snapshot(), rtol=0, atol=0)
