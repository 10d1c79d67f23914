"""The same algorithm on either's environments."""

import pytest

from needlehoop.config import composing
from needlehoop.learning.job import typed_job

LITTLE = ["num_envs=4", "algo.horizon=8", "algo.minibatch=16", "image_size=32", "steps=64"]


@pytest.mark.full
def test_stable_baselines_learns_on_either(monkeypatch):
    import others

    # The other side's share is kept small: it renders ten images a second.
    monkeypatch.setattr(others, "DM_CONTROL_ENVS", 1)
    monkeypatch.setattr(others, "STEPS", 4)
    try:
        found = others.measure(typed_job(composing.compose(LITTLE, "bench_train")), rounds=1)
    except RuntimeError as error:
        if "no OpenGL" not in str(error):
            raise
        pytest.skip(str(error))
    assert found["num_envs"] == {"needlehoop": 4, "dm_control": 1}
    rates = found["steps_per_second"]
    assert found["ratio"] == pytest.approx(rates["needlehoop"] / rates["dm_control"], rel=0.1)
    assert len(found["ratio_of_each_round"]) == 1
