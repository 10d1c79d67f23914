"""Processor time per image on one thread, by rendering and renderer.

    python benchmarks/renderers.py 6 image_size=64

The words are the number of rounds and settings of an environment. Images are of all views at the
start of an episode; composing their channels is not included. The renderers take turns, and time
that other processes take is not counted.
"""

import sys
import time
from dataclasses import replace

from needlehoop.engines.contract import RENDERERS, EngineConfig
from needlehoop.envs.build import build
from needlehoop.envs.settings import compose_settings

ENVS = 16


if __name__ == "__main__":
    rounds, *words = sys.argv[1:]
    settings = compose_settings(words)
    for rendering in settings.renderings:
        cams = tuple(f"{rendering}_{view}" for view in settings.views)
        engines = {}
        for kind in RENDERERS:
            engine = EngineConfig(1, kind, "cpu")
            simulation = build(replace(settings, cams=cams, num_envs=ENVS, engine=engine))
            simulation.reset()
            engines[kind] = simulation.engine
        least = dict.fromkeys(RENDERERS, float("inf"))
        for _ in range(int(rounds)):
            for kind, engine in engines.items():
                began = time.thread_time()
                engine.render()
                taken = 1e3 * (time.thread_time() - began) / (ENVS * len(cams))
                least[kind] = min(least[kind], taken)
        print(rendering, *(f"{kind} {taken:.4f} ms" for kind, taken in least.items()))
