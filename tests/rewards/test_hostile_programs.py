"""Programs that want out, or want the machine: each is refused, and nothing of it runs."""

from __future__ import annotations

import time
import tracemalloc

import pytest
from needle_task import compile_program

from needlehoop.rewards.language.program import MAX_SOURCE, ProgramError

OK = "reward = elapsed\n"

OUTSIDE = [
    "reward = goal.__class__.__subclasses__()",
    "import os\n" + OK,
    "__x = 1\n" + OK,
    "reward = f'{().__class__}'",
    "reward = goal[0]",
    "for i in goal:\n    reward = i",
    "reward = lambda: 1",
    "threaded = True\n" + OK,
    # Characters that look like others.
    "reward = ｅｌａｐｓｅｄ",
]

TOO_MUCH = [
    "reward = 1e999",
    "reward = elapsed ** 9",
    "#" * 10_000_000,
    "reward = " + "(" * 9000,
    "if grasped:\n    reward = 1\n" + "elif lifted:\n    reward = 1\n" * 300,
    OK + "#" * (MAX_SOURCE + 1 - len(OK)),
]


@pytest.mark.parametrize("sources", [OUTSIDE, TOO_MUCH], ids=["outside", "too_much"])
def test_each_is_refused_soon_and_cheaply(sources):
    for source in sources:
        tracemalloc.start()
        began = time.process_time()
        with pytest.raises(ProgramError):
            compile_program(source)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert time.process_time() - began < 1.0, source[:200]
        assert peak < 32e6, source[:200]
