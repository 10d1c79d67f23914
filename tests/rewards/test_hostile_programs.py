"""Programs that want out, or want the machine: each is refused, and nothing of it runs."""

from __future__ import annotations

import time
import tracemalloc

import pytest
from needle_task import compile_program

from needlehoop.rewards.language.program import MAX_SOURCE, ProgramError

OK = "reward = elapsed\n"

OUTSIDE = [
    # Attributes, imports and Python's own names.
    "reward = goal.__class__.__subclasses__()",
    "goal.data = tool_midpoint\n" + OK,
    "reward = __import__(0)",
    "import os\n" + OK,
    "__x = 1\n" + OK,
    # Strings, collections, subscripts.
    "reward = f'{().__class__}'",
    "reward = 'a' % elapsed",
    "reward = goal[0]",
    "a, b = 1, 2\n" + OK,
    # Statements and expressions.
    "for i in goal:\n    reward = i",
    "@exp\ndef f(): return 1\n" + OK,
    "elapsed\n" + OK,
    "reward = [i for i in goal]",
    "reward = lambda: 1",
    "reward = elapsed is elapsed",
    "reward = elapsed // 2",
    "reward = exp(*goal)",
    "reward = clip(elapsed, lo=0, hi=1)",
    # The verdict, and names that are taken.
    "reward = threaded",
    "threaded = True\n" + OK,
    "elapsed += 1\n" + OK,
    "where = elapsed\n" + OK,
    # Characters that look like others.
    "reward = ｅｌａｐｓｅｄ",
    "reward\0 = 1",
]

TOO_MUCH = [
    "reward = 1e999",
    "reward = " + "9" * 5000,
    "reward = elapsed ** 9",
    "reward = elapsed ** elapsed",
    "#" * 10_000_000,
    "reward = " + "(" * 9000,
    "reward = " + "exp(" * 1000 + "1" + ")" * 1000,
    "reward = " + "-" * 9000 + "1",
    "reward = " + "1 if grasped else " * 500 + "1",
    "if grasped:\n    reward = 1\n" + "elif lifted:\n    reward = 1\n" * 300,
    "".join(" " * i + "if grasped:\n" for i in range(90)) + " " * 90 + OK,
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


def test_the_longest_program_is_cheap_too():
    """What is within every bound compiles in time and memory that do not matter."""
    lines = [f"a{i} = {' * '.join(['jaw'] * 15)} + {i}" for i in range(60)]
    source = "\n".join([*lines, "reward = a1"])
    source += "\n#" + "-" * (MAX_SOURCE - len(source) - 2)
    many = f"reward = 1{' < 1' * 2400}"
    for text in (source, many):
        began = time.process_time()
        compile_program(text)
        assert time.process_time() - began < 2.0
    with pytest.raises(ProgramError, match="10001 characters"):
        compile_program(source + "-")
