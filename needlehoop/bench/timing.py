"""Where the time goes: calls timed from outside, and a bar while it takes minutes."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

from tqdm import tqdm

from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.learner import Learner


def rounds_of(count: int, what: str) -> Iterator[int]:
    """``range(count)`` with a bar that counts ``what``; it draws between rounds, never in one."""
    # Its monitor thread would wake up in the middle of what is timed.
    tqdm.monitor_interval = 0
    yield from tqdm(range(count), desc="measuring", unit=what, leave=False, disable=None)


class Stopwatch:
    """Adds up the seconds that one thread spends in the parts of its work.

    Images are made by other threads while this one works out facts and rewards. They count for
    as long as this thread waits for them.
    """

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._part = "acting"

    def watch_env(self, env: TorchRLEnv) -> None:
        """Time the physics and the images of an environment from now on."""
        engine: Any = env.simulation.engine
        engine.step = self._timed(engine.step, "physics")
        begin = env.workers.begin
        env.workers.begin = self._timed(lambda work: self._timed(begin(work), "images"), "images")

    def watch_learner(self, learner: Learner) -> None:
        """Time a learner's environment, its acting and its learning from now on."""
        self.watch_env(learner.env)
        # Networks, folding and the optimiser share their work in one place.
        learner.workers.map = self._timed(learner.workers.map)
        trainer: Any = learner.trainer
        trainer.update = self._during(trainer.update, "learning")

    def shares(self, total: float, *parts: str, rest: str) -> dict[str, float]:
        """Shares of ``total`` seconds by part; ``rest`` is what no part accounts for.

        They sum to 1, but for rounding to three digits.
        """
        shares = {name: self.seconds[name] / total for name in parts}
        shares[rest] = 1.0 - sum(shares.values())
        return {name: round(share, 3) for name, share in shares.items()}

    def _timed(self, call: Callable[..., Any], part: str | None = None) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds[part or self._part] += time.perf_counter() - began

        return timed

    def _during(self, call: Callable[..., Any], part: str) -> Callable[..., Any]:
        def run(*args: Any, **kwargs: Any) -> Any:
            before, self._part = self._part, part
            try:
                return call(*args, **kwargs)
            finally:
                self._part = before

        return run
