"""The gates: programs that must pass, and programs that must not, each for its own reason."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import torch
from needle_task import compile_program, random_signals

from needlehoop.cli.main import main
from needlehoop.config import composing, strict
from needlehoop.envs.settings import settings_from
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.tasks.contract import Task
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.vlm import writing
from needlehoop.vlm.config import Gates
from needlehoop.vlm.gate_report import gate_report
from needlehoop.vlm.moments import Trajectories, collect

# Tells threading from touching: the tip must be beyond the hoop's plane.
SOUND = """
reach = exp(-20 * distance(tool_midpoint, pickup_point))
held = 2 * grasped + 2 * lifted
near = exp(-50 * distance(needle_tip, goal))
through = 2 * clip(dot(needle_tip - goal, hoop_axis) / 0.006, 0, 1)
reward = reach + held + near + through
"""
# Pays the tip's distance alone, so the cheat gets what the expert gets.
FOOLED = "reward = 9 * exp(-50 * distance(needle_tip, goal))"


@pytest.fixture(scope="module")
def gates() -> Gates:
    shipped = strict.value(composing.compose([], "check"), "gates", Gates)
    return replace(shipped, episodes=2, random_signals=2000, random_episodes=4, stop_episodes=4)


@pytest.fixture(scope="module")
def quick(settings):
    """One thread: where the machine is busy, two would wait for each other."""
    return replace(settings, engine=replace(settings.engine, threads=1))


@pytest.fixture(scope="module")
def seen(quick, gates) -> Trajectories:
    return collect(quick, gates)


@pytest.fixture(scope="module")
def judge(quick, gates, seen):
    def judged(source: str, **changes):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("needlehoop.vlm.gate_report.collect", lambda *_: seen)
            return gate_report(compile_program(source), quick, replace(gates, **changes))

    return judged


def test_a_sound_program_passes(judge, seen, quick, gates):
    # Trajectories are flown once for all cameras.
    assert collect(replace(quick, cams=("rgb_side",)), gates) is seen
    assert bool(seen.last["expert"].threaded.all())
    assert bool(seen.last["cheat"].touched.all())
    assert not bool(seen.last["cheat"].threaded.any())
    report = judge(SOUND)
    assert report.passed
    assert report.reasons == report.flags == ()
    assert report.terms == ("reach", "held", "near", "through")
    assert report.paid > 0.5
    assert report.not_finite_random == report.not_finite_recorded == 0
    assert 0 <= report.lowest < report.random < report.cheat < report.expert <= report.highest <= 8


def test_what_is_not_finite_is_refused(judge):
    report = judge("reward = 1 / (elapsed - elapsed)")
    for what in ("2000 of 2000 random signals", f"of {report.recorded_moments} recorded moments"):
        assert any("not finite" in reason and what in reason for reason in report.reasons)
    json.dumps(report.as_dict(), allow_nan=False)
    # Points coincide in every eighth moment.
    report = judge(f"far = 1 / distance(tool_midpoint, goal)\n{SOUND.strip()} + 0 * far")
    assert (report.not_finite_random, report.not_finite_recorded) == (250, 0)
    # Two infinities that cancel do not hide in a sum.
    report = judge("a = 1 / (0 * jaw)\nb = 5\nreward = a + b")
    assert report.not_finite_random == report.random_signals


def test_a_range_that_is_too_wide_is_refused_or_clipped(judge):
    source = f"{SOUND.strip()} * 30 - 1"
    refused, clipped = judge(source), judge(source, range="clip")
    assert [why.split(";")[0][:8] for why in refused.reasons] == ["falls to", "rises to"]
    assert clipped.passed
    assert (clipped.lowest, clipped.highest) == (refused.lowest, refused.highest)
    assert clipped.gates.low <= clipped.random <= clipped.expert <= clipped.gates.top


def test_a_program_that_the_cheat_fools_is_flagged(judge):
    report = judge(FOOLED)
    assert report.passed
    assert "without threading" in report.flags[0]
    refused = judge(FOOLED, audit="refuse")
    assert refused.reasons == report.flags[:1]
    assert refused.flags == report.flags[1:]
    gap = report.expert - report.cheat
    assert not any("without threading" in flag for flag in judge(FOOLED, audit_margin=gap).flags)
    # The cheat's episodes last to the limit; a cost of time alone must not save a program.
    assert judge(f"{FOOLED} + 2 * (1 - elapsed) - 2", range="clip").flags


@pytest.mark.parametrize(
    ("source", "share"),
    [
        # Time passes by itself.
        ("reward = 9 * (1 - elapsed)", 0.0),
        ("reward = 9 * exp(-20 * distance(tool_midpoint, pickup_point))", 1.0),
    ],
)
def test_how_often_random_actions_are_paid(judge, source, share):
    report = judge(source)
    assert report.paid == pytest.approx(share, abs=0.08)
    assert any("of random steps are paid" in flag for flag in report.flags) == (share == 0)
    # It is never a reason to refuse.
    assert not any("random steps" in reason for reason in report.reasons)


def test_the_papers_own_rewards_are_seen_through(judge):
    """Its text reward was gamed in training: the hoop's centre pays more than going through."""
    files = (RECORDINGS / "paper/rewards").glob("*/*.txt")
    reports = {f"{path.parent.name}/{path.stem}": judge(path.read_text()) for path in files}
    assert len(reports) == 4
    text = reports.pop("any/text")
    assert text.passed
    assert "touching the goal without threading" in text.flags[0]
    assert text.flags[1].startswith("the teacher holding still at touched ends 0.")
    assert text.flags[1].endswith(" above finishing the task")
    assert text.paid > 0.5
    # Random actions hardly ever change the others.
    assert all(one.paid < 0.1 and "random steps" in one.flags[-1] for one in reports.values())
    (refused,) = (one for one in reports.values() if not one.passed)
    assert ["rises to" in reason for reason in refused.reasons] == [True]


def test_the_recorded_models_rewards_pass(judge):
    files = [*RECORDINGS.glob("claude_8210a79/rewards/*/*.txt")]
    files += RECORDINGS.glob("claude/rewards/*/*.txt")
    assert len(files) == 14
    reports = [judge(path.read_text()) for path in files]
    assert all(report.passed and report.paid > 0.4 for report in reports)


def test_a_program_that_pays_more_for_stopping_is_flagged_or_refused(judge):
    assert any("finishing" in flag for flag in judge(SOUND, stop_margin=2.0).flags)
    refused = judge(SOUND, stop_margin=2.0, stop="refuse")
    assert any("finishing" in reason for reason in refused.reasons)


def test_the_teacher_stops_where_facts_and_phases_say(seen):
    assert list(seen.stopped) == [
        "holding still at grasped",
        "letting go at grasped",
        "holding still at lifted",
        "holding still at touched",
        "letting go at touched",
        "holding still at half of reach",
        "holding still at half of lift",
        "holding still at half of insert",
    ]
    for how, (short, whole) in seen.stopped.items():
        assert not bool(short.threaded.any())
        assert bool(whole.threaded.all())
        assert bool((short.elapsed == whole.elapsed).all())
        held = how.startswith("holding") and "reach" not in how
        assert bool((short.grasped == held).all()), how


def rules_of(task: str, gates: Gates) -> tuple[Task, writing.ProgramRules]:
    few = replace(gates, random_signals=160, random_episodes=2, stop_episodes=1, audit="refuse")
    settings = settings_from(composing.compose([f"task={task}", "engine.threads=1"], "check"))
    return settings.definition, writing.program_rules(settings, few)


def test_another_tasks_cheat_is_seen_through_and_not_named(gates):
    task, rules = rules_of("peg_transfer", gates)
    fooled = rules.judge("reward = 9 * exp(-20 * distance(block_position, goal))")
    assert fooled.reason is not None
    assert fooled.reason.startswith("an episode that fails at the task ends")
    assert task.cheating in fooled.report["reasons"][0]
    near = "near = exp(-20 * distance(block_position, goal))"
    assert rules.judge(f"{near}\nreward = near * (8 if jaw > 0.6 else 5)").reason is None


def test_a_task_without_a_cheat_has_no_audit(gates):
    _, rules = rules_of("reach", gates)
    verdict = rules.judge("reward = 9 * exp(-40 * distance(tool_midpoint, target))")
    assert (verdict.reason, verdict.report["cheat"]) == (None, None)


def test_random_signals_are_wild_but_possible():
    signals = random_signals(4000, seed=0)
    for name, row in TASK.signals.items():
        value = getattr(signals, name)
        if row.unit == "bool":
            assert 0.4 < float(value.double().mean()) < 0.6
        elif row.unit == "m":
            assert 0.29 < float(value.abs().max()) <= 0.3
        elif row.unit == "1" and row.shape:
            torch.testing.assert_close(value.norm(dim=-1), torch.ones(4000, dtype=torch.float64))


@pytest.fixture
def check(seen, monkeypatch, elsewhere):
    """``needlehoop vlm check`` of a program, with the trajectories that are there."""
    monkeypatch.setattr("needlehoop.vlm.gate_report.collect", lambda *_: seen)

    def run(source: str, *words: str) -> int:
        (elsewhere / "mine.txt").write_text(source)
        return main(["vlm", "check", "mine.txt", "gates.random_signals=200", *words])

    return run


def test_check_prints_the_report(check, capsys):
    assert check(SOUND) == 0
    out = capsys.readouterr().out
    assert out.startswith("program      mine.txt\nterms        reach, held, near, through\n")
    assert "% of random steps change it by 0.001 or more; at least 10 % is asked (flag)" in out
    assert out.endswith("verdict      passed\n")
    assert check("reward = 40", "--json") == 1
    report = json.loads(capsys.readouterr().out)
    assert (report["passed"], report["highest"]) == (False, 40)
    assert any("rises to 40" in reason for reason in report["reasons"])
    assert any("above a random policy" in reason for reason in report["reasons"])
    assert check("reward = 1\nimport os") == 1
    assert "mine.txt: line 2, column 1: Import is not in" in capsys.readouterr().out
    assert main(["vlm", "check"]) == 2
    assert "name a file" in capsys.readouterr().err
