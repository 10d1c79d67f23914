"""Where a learner's time goes: calls timed from outside, so that training itself knows no clock."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from needlehoop.learning.learner import Learner

PARTS = ("physics", "images", "acting", "learning")
"""What all threads share; the rest is one thread's."""


class Stopwatch:
    """Adds up the seconds that a learner's thread spends in parts that all threads share.

    Images are made while that thread works out facts and rewards; they count for as long as it
    waits for them.

    Args:
        learner: whose calls are timed from now on.
    """

    def __init__(self, learner: Learner):
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._part = "acting"
        engine: Any = learner.env.simulation.engine
        engine.step = self._timed(engine.step, "physics")
        aside = learner.env.workers
        begin = aside.begin
        aside.begin = self._timed(lambda work: self._timed(begin(work), "images"), "images")
        # Networks, folding and the optimiser share their work in one place.
        learner.workers.map = self._timed(learner.workers.map)
        method: Any = learner.method
        method.ppo.update = self._during(method.ppo.update, "learning")

    def clear(self) -> None:
        """Start anew."""
        self.seconds.clear()

    def shares(self, total: float) -> dict[str, float]:
        """Shares of ``total`` seconds by part; ``one_thread`` is what no part accounts for."""
        shares = {name: self.seconds[name] / total for name in PARTS}
        return {**shares, "one_thread": 1.0 - sum(shares.values())}

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
