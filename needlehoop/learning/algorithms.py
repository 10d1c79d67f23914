"""The methods of training by name: each is a file beside this one, and one of ``conf/algo``."""

from __future__ import annotations

from needlehoop.learning.algorithm import Algorithm
from needlehoop.learning.dagger import Dagger
from needlehoop.learning.ppo import Ppo
from needlehoop.learning.sac import Sac
from needlehoop.runs.files import DAGGER, PPO, SAC

ALGORITHMS: dict[str, type[Algorithm]] = {PPO: Ppo, DAGGER: Dagger, SAC: Sac}
"""By ``algo.kind``; their settings are in ``algorithm_config.CONFIGS``."""
