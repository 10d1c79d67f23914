"""What a reward program costs: milliseconds to compile it, and for one call.

    python benchmarks/reward_program.py 200 80

The words are the number of rounds and the number of environments in the batch.
"""

import sys
import time

from needlehoop.rewards.language.program import compile_program
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.vlm.moments import random_signals

PROGRAM = """\
reach = exp(-40 * clip(distance(tool_midpoint, pickup_point) - 0.005, 0, 10))
grasp = 1 * (1 if grasped else reach)
raised = exp(-40 * clip(distance(pickup_point, lift_position) - 0.005, 0, 10))
lift = 3 * (1 if lifted else raised)
hoop = 0
if lifted:
    hoop = 3 * exp(-40 * clip(distance(needle_tip, goal) - 0.005, 0, 10))
closed = 2 if grasped and jaw_command < 0.1 else 0
time = -1 * elapsed
reward = grasp + lift + hoop + closed + time
"""
"""Ten lines that say the paper's terms of the human reward."""

CALLS = 20
"""Calls per round."""


if __name__ == "__main__":
    rounds, num_envs = (int(word) for word in sys.argv[1:])
    signals = random_signals(TASK, num_envs, seed=0)
    call = compiling = float("inf")
    for _ in range(rounds):
        began = time.perf_counter()
        program = compile_program(PROGRAM, TASK.signals)
        compiled = time.perf_counter()
        for _ in range(CALLS):
            program(signals)
        compiling = min(compiling, compiled - began)
        call = min(call, (time.perf_counter() - compiled) / CALLS)
    print(f"call {1000 * call:.4f} ms, compile {1000 * compiling:.3f} ms")
