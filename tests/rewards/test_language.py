"""What programs say, and what they are worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from needle_task import compile_program, load_reward, random_signals
from reward_program import PROGRAM

from needlehoop.config import composing
from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.rewards.language.program import ProgramError
from needlehoop.scene.signals import Signals, vocabulary
from needlehoop.tasks.needle_hoop import TASK

TABLE = TASK.signals

N = 7


@pytest.fixture(scope="module")
def signals() -> Signals:
    return random_signals(N, seed=3)


def value_of(expression: str, signals: Signals) -> torch.Tensor:
    terms = compile_program(f"reward = {expression}")(signals)
    assert list(terms) == ["reward"]
    return terms["reward"]


def refused(source: str) -> ProgramError:
    with pytest.raises(ProgramError) as caught:
        compile_program(source)
    return caught.value


def test_the_papers_reward_can_be_said():
    human = load_reward(composing.compose([])["reward"])
    many = random_signals(500, seed=1)
    # Nearer than random, so that no term is all zeros.
    many.pickup_point = many.tool_midpoint + 0.01 * many.hoop_axis
    many.needle_tip = many.goal - 0.01 * many.hoop_axis
    terms, meant = compile_program(PROGRAM)(many), human(many)
    assert [name for name in meant if name not in ("surround", "pinch")] == [*terms]
    for name in terms:
        assert meant[name].abs().max() > 0.1
        torch.testing.assert_close(terms[name], meant[name], rtol=1e-14, atol=1e-14)


# Each expression beside what it means for one environment, as numpy says it.
MEANT = {
    "elapsed + 2 * jaw - jaw_command / 4": lambda s: s.elapsed + 2 * s.jaw - s.jaw_command / 4,
    "+elapsed": lambda s: s.elapsed,
    "elapsed ** 0.5": lambda s: math.sqrt(s.elapsed),
    "distance(goal, needle_tip)": lambda s: np.linalg.norm(s.goal - s.needle_tip),
    "distance(tool_quat, needle_quat)": lambda s: np.linalg.norm(s.tool_quat - s.needle_quat),
    "norm(joints)": lambda s: np.linalg.norm(s.joints),
    "dot(hoop_axis, needle_tip - goal)": lambda s: s.hoop_axis @ (s.needle_tip - s.goal),
    "x(goal) + 10 * y(goal) + 100 * z(goal)": lambda s: s.goal @ [1, 10, 100],
    "component(joints, 5)": lambda s: s.joints[5],
    "z(rotate(tool_quat, vector(0, 0, 1)))": lambda s: (
        1 - 2 * (s.tool_quat[1] ** 2 + s.tool_quat[2] ** 2)
    ),
    "norm(vector(1, elapsed, 2))": lambda s: np.linalg.norm([1, s.elapsed, 2]),
    "norm(-goal * elapsed)": lambda s: np.linalg.norm(s.goal * s.elapsed),
    "clip(jaw, -1, 1)": lambda s: np.clip(s.jaw, -1, 1),
    "exp(jaw)": lambda s: np.exp(s.jaw),
    "log(elapsed)": lambda s: np.log(s.elapsed),
    "sqrt(elapsed)": lambda s: np.sqrt(s.elapsed),
    "tanh(jaw)": lambda s: np.tanh(s.jaw),
    "abs(jaw)": lambda s: abs(s.jaw),
    "min(jaw, elapsed, 0.2)": lambda s: min(s.jaw, s.elapsed, 0.2),
    "max(jaw, elapsed)": lambda s: max(s.jaw, s.elapsed),
    "where(jaw > 0, 1, elapsed)": lambda s: 1 if s.jaw > 0 else s.elapsed,
    "norm(goal if lifted else vector(3, 0, 4))": lambda s: (
        np.linalg.norm(s.goal) if s.lifted else 5
    ),
    "2 if grasped else 1 if lifted else 0": lambda s: 2 if s.grasped else 1 if s.lifted else 0,
    "3 * grasped + lifted": lambda s: 3 * s.grasped + s.lifted,
    "grasped and not lifted or jaw > 1": lambda s: (s.grasped and not s.lifted) or s.jaw > 1,
    "-1 < jaw <= 1": lambda s: -1 < s.jaw <= 1,
    "0.5 > elapsed >= 0.1 != jaw": lambda s: 0.5 > s.elapsed >= 0.1,
    "jaw_1_touch != jaw_2_touch": lambda s: s.jaw_1_touch != s.jaw_2_touch,
    "1 + (2 if True else 0) - 1": lambda s: 2,
    "(\n  elapsed  # so far\n  + 1\n)": lambda s: s.elapsed + 1,
}


class One:
    """One environment's signals, in numpy."""

    def __init__(self, signals: Signals, index: int):
        for name in TABLE:
            value = getattr(signals, name)[index].numpy()
            setattr(self, name, value if value.ndim else value.item())


def test_an_expression_is_worth_what_it_says_in_a_batch_and_alone(signals):
    assert {name for name in FUNCTIONS if any(f"{name}(" in e for e in MEANT)} == set(FUNCTIONS)
    for expression, worth in MEANT.items():
        values = value_of(expression, signals)
        meant = [float(worth(One(signals, i))) for i in range(N)]
        assert values.tolist() == pytest.approx(meant, rel=1e-12, abs=1e-15), expression
        alone = [value_of(expression, signals[index : index + 1]).item() for index in range(N)]
        assert alone == values.tolist(), expression


BRANCHES = """
a = 0
b = jaw
if elapsed < 0.25:
    a = 1
elif elapsed < 0.5:
    a = 2
    b = 10
    if lifted:
        a += 0.5
        b *= 2
else:
    c = 3 * elapsed
    a = c
reward = a + b
"""


def test_ifs_choose_in_each_environment():
    many = random_signals(200, seed=8)
    terms = compile_program(BRANCHES)(many)
    cases = set()
    for i in range(200):
        elapsed, lifted = float(many.elapsed[i]), bool(many.lifted[i])
        a, b = 0.0, float(many.jaw[i])
        if elapsed < 0.25:
            a = 1.0
        elif elapsed < 0.5:
            a, b = (2.5, 20.0) if lifted else (2.0, 10.0)
        else:
            a = 3 * elapsed
        cases.add((elapsed < 0.25, elapsed < 0.5, lifted))
        assert (terms["a"][i], terms["b"][i]) == (a, b)
    assert len(cases) == 6
    # What is not finite in a branch that is not taken leaves nothing behind.
    source = "if jaw > 9:\n    reward = log(jaw - jaw)\nelse:\n    reward = 7"
    assert compile_program(source)(many)["reward"].tolist() == [7.0] * 200


def test_a_variable_of_one_branch_is_refused_only_where_it_is_used():
    source = "if lifted:\n    d = 1\n    reward = d\nelse:\n    reward = 0\n"
    assert compile_program(source).terms == ("reward",)
    error = refused(source + "reward = reward + d")
    assert (error.line, error.column) == (6, 19)
    assert "'d' is unknown" in error.reason


@pytest.mark.parametrize(
    ("end", "terms"),
    [
        ("reward = a + b + c", ("a", "b", "c")),
        ("reward = a + b\nc = 5\na = 6", ("a", "b")),
        ("reward = a", ("reward",)),
        ("reward = a + 2 * b", ("reward",)),
        ("reward = a + a", ("reward",)),
        ("reward = a + b\nreward = reward + c", ("reward",)),
        ("if lifted:\n    reward = a + b\nelse:\n    reward = 0", ("reward",)),
    ],
)
def test_terms_are_the_names_of_the_last_sum(end, terms, signals):
    program = compile_program(f"a = jaw\nb = elapsed\nc = jaw * elapsed\n{end}")
    before = signals.clone()
    assert program.terms == terms
    values = program(signals)
    assert tuple(values) == terms
    assert all(term.shape == (N,) and term.dtype == torch.float64 for term in values.values())
    if "a" in terms:
        torch.testing.assert_close(values["a"], signals.jaw, rtol=0, atol=0)
    # Terms do not share memory with the signals.
    for term in values.values():
        term += 1
    assert bool((signals == before).all())


def test_what_is_not_finite_is_passed_on(signals):
    assert value_of("log(0 * jaw)", signals).tolist() == [-math.inf] * N
    assert value_of("1 / (0 * elapsed)", signals).tolist() == [math.inf] * N
    assert value_of("sqrt(-1)", signals).isnan().all()


def test_a_refusal_says_where_and_why():
    for source, line, column, reason in (
        ("a = 1\nreward = a * b", 2, 14, "'b' is unknown; signals: tool_midpoint"),
        ("reward = cos(jaw)", 1, 10, "'cos' is no function; choose from distance"),
        ("reward = distance(goal, tool_quat)", 1, 10, "vectors of different lengths"),
        ("reward = 1 if jaw else 0", 1, 15, "a number, where a truth value"),
        ("reward = goal if lifted else 0", 1, 10, "it must be of one kind"),
        ("reward = jaw ** elapsed", 1, 17, "exponent"),
        ("if lifted:\n    reward = 1", 2, 1, "in every branch"),
    ):
        error = refused(source)
        assert (error.line, error.column) == (line, column), source
        assert reason in error.reason
        assert str(error) == f"line {line}, column {column}: {error.reason}"


def test_every_signal_but_the_verdicts_can_be_read(signals):
    for name, row in vocabulary(TABLE).items():
        value_of(f"norm({name})" if row.shape else name, signals)
    for name in TABLE.keys() - vocabulary(TABLE).keys():
        assert "verdict" in refused(f"reward = {name}").reason
