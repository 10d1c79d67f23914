"""What a compiled reward program costs."""

from __future__ import annotations

import time

from needlehoop.bench.waiting import rounds_of
from needlehoop.rewards.language.program import compile_program
from needlehoop.runs.machine import machine
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
"""Ten lines that say the human reward."""

_CALLS = 20
"""Calls per timing."""


def measure_program(num_envs: int, rounds: int) -> dict[str, object]:
    """Milliseconds for one call of ``PROGRAM``, and to compile it; best of 40 x ``rounds``.

    Args:
        num_envs: environments in the batch.
        rounds: how long to try; what else the machine does only ever adds.

    Raises:
        ValueError: ``rounds`` below 1.
    """
    if rounds < 1:
        raise ValueError(f"rounds: {rounds} must be at least 1")
    signals = random_signals(num_envs, seed=0)
    call = compiling = float("inf")
    for _ in rounds_of(40 * rounds, "round"):
        began = time.perf_counter()
        program = compile_program(PROGRAM)
        compiled = time.perf_counter()
        for _ in range(_CALLS):
            program(signals)
        called = time.perf_counter()
        compiling = min(compiling, compiled - began)
        call = min(call, (called - compiled) / _CALLS)
    return {
        "machine": machine(),
        "num_envs": num_envs,
        "lines": PROGRAM.count("\n"),
        "call_ms": round(1000 * call, 4),
        "compile_ms": round(1000 * compiling, 3),
    }
