"""What is timed, and the bar meanwhile."""

import io
import time

import pytest

from needlehoop.bench.speed import Stopwatch, rounds_of
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.torchrl_env import TorchRLEnv


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_counts_rounds_where_somebody_watches(monkeypatch):
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr("sys.stderr", stream)
        assert [*rounds_of(3, "buffer")] == [0, 1, 2]
        assert ("measuring" in stream.getvalue()) == drawn


@pytest.mark.parametrize("threads", [1, 2])
def test_shares_of_a_step_sum_to_one(threads):
    words = ["cams=[dep_front]", "num_envs=3", "image_size=16", f"engine.threads={threads}"]
    env, watch = TorchRLEnv(compose_settings(words)), Stopwatch()
    watch.watch_env(env)
    began = time.perf_counter()
    env.rollout(4)
    shares = watch.shares(time.perf_counter() - began, "physics", "images", rest="other")
    assert set(shares) == {"physics", "images", "other"}
    assert min(shares.values()) > 0
    assert sum(shares.values()) == pytest.approx(1.0, abs=0.002)
