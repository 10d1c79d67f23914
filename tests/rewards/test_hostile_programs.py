"""Programs that want out, or want the machine: each is refused, soon and cheaply."""

from __future__ import annotations

import ast
import time
import tracemalloc

import pytest
from needle_task import compile_program

from needlehoop.rewards.language.grammar import MAX_SOURCE, ProgramError, parse

OK = "reward = elapsed\n"


def inside(expression: str) -> str:
    return f"reward = {expression}"


HOSTILE: dict[str, list[str]] = {
    "attributes": [
        inside("goal.shape"),
        inside("goal.__class__"),
        inside("goal.__class__.__subclasses__()"),
        inside("distance.__globals__"),
        inside("(1).__class__"),
        inside("1..real"),
        inside("elapsed.add_(1)"),
        "goal.data = tool_midpoint\n" + OK,
        "reward.x = 1",
    ],
    "dunders and builtins": [
        inside("__import__"),
        inside("__import__(0)"),
        inside("eval(elapsed)"),
        inside("exec(elapsed)"),
        inside("open(0)"),
        inside("getattr(goal, elapsed)"),
        inside("globals()"),
        inside("breakpoint()"),
        inside("torch"),
        "__x = 1\n" + OK,
    ],
    "the verdict": [
        inside("threaded"),
        inside("touched"),
        inside("9 if threaded else 0"),
        "threaded = True\n" + OK,
        "if threaded:\n    reward = 1\nelse:\n    reward = 0",
    ],
    "shadowed names": [
        "goal = 1\n" + OK,
        "elapsed += 1\n" + OK,
        "distance = 1\n" + OK,
        "where = elapsed\n" + OK,
        "touched = grasped\n" + OK,
        "True = 1\n" + OK,
        "if lifted:\n    goal = 1\n" + OK,
        inside("distance"),
    ],
    "strings": [
        inside("'a'"),
        inside('"a"'),
        inside("'%s' % elapsed"),
        inside("'{0.__class__}'.format(goal)"),
        inside("f'{().__class__}'"),
        inside("rb'a'"),
        inside("'\\N{DIGIT ONE}'"),
        '"""a docstring"""\n' + OK,
        "'unterminated\n" + OK,
        '"""unterminated\n' + OK,
    ],
    "collections": [
        inside("[1]"),
        inside("{}"),
        inside("{1: 2}"),
        inside("()"),
        inside("(1,)"),
        inside("1, 2"),
        inside("goal[0]"),
        inside("..."),
        "...\n" + OK,
        "a[0] = 1\n" + OK,
        "a, b = 1, 2\n" + OK,
        "a = b = 1\n" + OK,
        "*a, = goal\n" + OK,
    ],
    "comprehensions and loops": [
        inside("[i for i in goal]"),
        inside("(i for i in goal)"),
        inside("max(i for i in goal)"),
        "for i in goal:\n    reward = i",
        "while True:\n    reward = 1",
        "break\n" + OK,
    ],
    "statements": [
        "import os\n" + OK,
        "from os import system\n" + OK,
        "from __future__ import annotations\n" + OK,
        "def f():\n    return 1\n" + OK,
        "async def f():\n    await 1\n" + OK,
        "class C:\n    reward = 1\n" + OK,
        "@exp\ndef f(): return 1\n" + OK,
        "lambda: 1\n" + OK,
        "global reward\n" + OK,
        "del goal\n" + OK,
        "assert True\n" + OK,
        "raise 1\n" + OK,
        "return 1",
        "yield 1",
        "await goal",
        "pass\n" + OK,
        "try:\n    reward = 1\nexcept:\n    reward = 0",
        "with goal as g:\n    reward = 1",
        "match goal:\n    case _:\n        reward = 1",
        "type T = int\n" + OK,
        "print elapsed\n" + OK,
        "elapsed\n" + OK,
        "reward: float = 1",
        "reward: exit()",
        "reward = 1; reward = 2",
        "if lifted: reward = 1",
        "if (a := elapsed) > 0:\n    reward = 1\nelse:\n    reward = 0",
    ],
    "expressions": [
        inside("(a := 1)"),
        inside("max(a := 1, 2)"),
        inside("lambda: 1"),
        inside("await goal"),
        inside("(yield)"),
        inside("None"),
        inside("elapsed is elapsed"),
        inside("elapsed in goal"),
        inside("goal @ goal"),
        inside("elapsed // 2"),
        inside("elapsed % 2"),
        inside("1 << 9"),
        inside("1 | 2"),
        inside("1 ^ 2"),
        inside("~1"),
        inside("!grasped"),
        inside("grasped && lifted"),
        inside("`elapsed`"),
        inside("1 <> 2"),
        inside("elapsed -> 1"),
        inside("exp(*goal)"),
        inside("max(1, *goal)"),
        inside("max(**goal)"),
        inside("exp(a=1)"),
        inside("clip(elapsed, lo=0, hi=1)"),
        inside("exp(exp)(1)"),
        inside("(exp if grasped else log)(1)"),
        inside("elapsed()"),
        inside("exp()"),
        inside("exp(1, 2)"),
        inside("max(1)"),
        inside("component(goal, 9)"),
        inside("component(goal, 0 - 1)"),
        inside("component(goal, elapsed)"),
        inside("component(goal, 0.5)"),
        "reward **= 9\n" + OK,
        "reward += 1",
        "a //= 2\n" + OK,
    ],
    "kinds": [
        inside("goal"),
        inside("goal + 1"),
        inside("1 / goal"),
        inside("goal ** 2"),
        inside("goal < goal"),
        inside("not elapsed"),
        inside("elapsed and grasped"),
        inside("1 if elapsed else 0"),
        inside("goal if grasped else 0"),
        inside("distance(goal, needle_quat)"),
        inside("x(needle_quat)"),
        inside("exp(goal)"),
        inside("where(elapsed, 1, 0)"),
        "if elapsed:\n    reward = 1\nelse:\n    reward = 0",
        "if grasped:\n    reward = 1",
        "if grasped:\n    a = 1\nreward = a",
        "if grasped:\n    a = 1\nelse:\n    a = goal\nreward = 0",
        "",
        "\n\n",
        "a = 1",
    ],
    "numbers": [
        inside("1j"),
        inside("1e999"),
        inside("1e7"),
        inside("9" * 25),
        inside("0x" + "f" * 20),
        inside("1_000"),
        inside("007"),
        inside("1if grasped else 0"),
        inside("0x1for x in goal"),
        inside("elapsed ** 9"),
        inside("9 ** 9 ** 9"),
        inside("elapsed ** elapsed"),
        inside("elapsed ** -9"),
        inside("2 ** (4 * 4)"),
        inside("elapsed ** True"),
    ],
    "characters": [
        "reward\0 = 1",
        "\ufeff" + OK,
        inside("еlapsed"),
        "rеward = 1",
        inside("ｅｌａｐｓｅｄ"),
        inside("ﬁnite"),
        inside("elapsed\u200b"),
        "# \u202e hidden\n" + OK,
        "# \f hidden\n" + OK,
        inside("٣"),
        inside("2 × 3"),
        inside("elapsed²"),
        "reward\u00a0= 1",
        "reward = 1\u2028reward = 2",
        "reward =\t1",
        "if grasped:\n\treward = 1\nelse:\n        reward = 0",
        "\freward = 1",
        "reward = 1\r\nreward = 2",
        "reward = 1\rimport os",
        "reward = 1\x1b[2J",
        "reward = \\\n1",
        "\\\nreward = 1",
        "\udcff" + OK,
    ],
    "encoding cookies": [
        "# -*- coding: utf-7 -*-\nreward = +AGEAYg-",
        "# coding: rot13\nerjneq = 1",
    ],
    "layout": [
        " reward = 1",
        "if grasped:\nreward = 1",
        "if grasped:\n    reward = 1\n  reward = 2",
        "else:\n    reward = 1",
        "reward =",
        "reward = (1",
        "reward = 1)",
        "if grasped\n    reward = 1",
        "1 = reward",
        "reward == 1",
    ],
    "size": [
        "#" * 10_000_000,
        "a" * 10_000_000,
        "\n" * 10_000_000,
        "reward = 1\n" * 1_000_000,
        inside("1" + " + 1" * 2_500_000),
        "a = 1\n" * 101 + OK,
        inside("a" * 41),
        inside(" + ".join(["elapsed"] * 200)),
        "\n".join(f"a{i} = {' + '.join(['elapsed'] * 40)}" for i in range(30)) + "\n" + OK,
    ],
    "depth": [
        inside("(" * 21 + "1" + ")" * 21),
        inside("(" * 9000),
        inside("exp(" * 1000 + "1" + ")" * 1000),
        inside("-" * 9000 + "1"),
        inside("-" * 200 + "1"),
        inside("not " * 2000 + "grasped"),
        inside("not " * 200 + "grasped"),
        inside("1" + "+1" * 4000),
        inside("1" + "-1" * 100),
        inside("1" + "**1" * 100),
        inside("grasped" + " and grasped" * 800),
        inside("1" + " < 1" * 2000),
        inside("1 if grasped else " * 500 + "1"),
        inside("1 if grasped else " * 70 + "1"),
        inside("exp" + "(1)" * 60),
        "a = " * 140 + "1",
        "".join(" " * i + "if grasped:\n" for i in range(90)) + " " * 90 + OK,
        "".join(" " * i + "if grasped:\n" for i in range(17)) + " " * 17 + OK + OK,
        "if grasped:\n    reward = 1\n" + "elif lifted:\n    reward = 1\n" * 300,
        "if grasped:\n    reward = 1\n"
        + "elif lifted:\n    reward = 1\n" * 17
        + "else:\n    "
        + OK,
        " " * 9000 + OK,
        "if grasped:\n" + " " * 65 + OK + OK,
    ],
}


def refused(source: str) -> ProgramError:
    try:
        compile_program(source)
    except ProgramError as error:
        return error
    pytest.fail(f"accepted: {source[:200]!r}")


def test_there_are_enough_of_them():
    assert len({source for sources in HOSTILE.values() for source in sources}) >= 200


def test_what_they_are_built_from_is_accepted():
    """So that none is refused for its frame."""
    assert compile_program(OK).terms == ("reward",)
    assert compile_program(inside("elapsed")).terms == ("reward",)
    assert compile_program(f"a = 1\n{OK}").terms == ("reward",)


@pytest.mark.parametrize("category", HOSTILE)
def test_each_is_refused_soon(category):
    for source in HOSTILE[category]:
        began = time.process_time()
        error = refused(source)
        assert time.process_time() - began < 1.0, source[:200]
        assert isinstance(error, ValueError)
        assert str(error) == f"line {error.line}, column {error.column}: {error.reason}"
        assert 1 <= error.line <= source.count("\n") + 1, source[:200]
        assert 1 <= error.column <= max(map(len, source.split("\n"))) + 1, source[:200]
        # A reason is a line that a person or a model can act on, not an echo of the attack.
        assert 5 < len(error.reason) < 500, source[:200]
        assert error.reason.isprintable(), source[:200]


@pytest.mark.parametrize("category", ["size", "depth", "numbers"])
def test_little_memory_is_used(category):
    for source in HOSTILE[category]:
        tracemalloc.start()
        try:
            refused(source)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 8e6


def test_the_longest_program_is_cheap_too():
    """What is within every bound compiles in time and memory that do not matter."""
    lines = [f"a{i} = {' * '.join(['jaw'] * 15)} + {i}" for i in range(60)]
    source = "\n".join([*lines, "reward = a1"])
    source += "\n#" + "-" * (MAX_SOURCE - len(source) - 2)
    assert len(source) == MAX_SOURCE
    tracemalloc.start()
    began = time.process_time()
    try:
        compile_program(source)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < 2.0
    assert peak < 16e6
    refused(source + "-")


def test_the_parser_never_sees_what_is_not_in_the_language(monkeypatch):
    seen = []
    real = ast.parse

    def watch(source: str) -> ast.Module:
        seen.append(source)
        return real(source)

    with monkeypatch.context() as patch:
        patch.setattr(ast, "parse", watch)
        parse(OK)
        for category in ("strings", "characters"):
            for source in HOSTILE[category]:
                refused(source)
    assert seen == [OK]
