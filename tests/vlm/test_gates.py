"""The gates: programs that must pass, and programs that must not, each for its own reason."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
import torch
from needle_task import compile_program, random_signals

from needlehoop.cli.main import main
from needlehoop.config import composing, strict
from needlehoop.envs.settings import Settings, settings_from
from needlehoop.rewards import program_reward, reference_reward
from needlehoop.rewards.language import program as language
from needlehoop.tasks.needle_hoop import TASK
from needlehoop.vlm import writing
from needlehoop.vlm.card import card
from needlehoop.vlm.config import Gates
from needlehoop.vlm.moments import Trajectories, collect

TABLE = TASK.signals

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


def made(overrides: list[str]) -> Gates:
    return strict.value(composing.compose(overrides, "check"), "gates", Gates)


@pytest.fixture(scope="module")
def gates() -> Gates:
    return replace(made([]), episodes=2, random_signals=2000, random_episodes=4, stop_episodes=4)


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
        return card(compile_program(source), quick, replace(gates, **changes), seen)

    return judged


def test_a_sound_program_passes(judge):
    found = judge(SOUND)
    assert found.passed
    assert found.reasons == found.flags == ()
    assert found.terms == ("reach", "held", "near", "through")
    assert found.paid > 0.5
    assert found.not_finite_random == found.not_finite_recorded == 0
    assert 0 <= found.lowest < found.random < found.cheat < found.expert <= found.highest <= 8


def test_the_controllers_do_what_they_are_for(seen, gates):
    last = seen.last
    assert bool(last["expert"].threaded.all())
    assert bool(last["cheat"].touched.all())
    assert not bool(last["cheat"].threaded.any())
    assert not bool(last["random"].grasped.any())
    assert all(len(signals.elapsed) == gates.episodes for signals in last.values())
    # Starts are in; what comes after an episode's end is not.
    elapsed = seen.moments.elapsed
    assert int((elapsed == 0).sum()) == 3 * gates.episodes
    assert int(seen.moments.threaded.sum()) == gates.episodes


@pytest.mark.parametrize(
    ("expression", "count"),
    [("log(elapsed - 0.5)", "random signals"), ("1 / (elapsed - elapsed)", "recorded moments")],
)
def test_what_is_not_finite_is_refused(judge, expression, count):
    found = judge(f"reward = clip({expression}, 0, 1) + {expression}")
    assert not found.passed
    assert any("not finite" in reason and count in reason for reason in found.reasons)


def test_points_that_coincide_are_among_the_random_signals(judge):
    found = judge(f"far = 1 / distance(tool_midpoint, goal)\n{SOUND.strip()} + 0 * far")
    assert found.not_finite_random == 250
    assert found.not_finite_recorded == 0
    assert len(found.reasons) == 1
    json.dumps(found.as_dict(), allow_nan=False)


def test_terms_are_finite_one_by_one(judge):
    """Two infinities that cancel must not hide in a sum."""
    found = judge("a = 1 / (0 * jaw)\nb = 5\nreward = a + b")
    assert found.not_finite_random == found.random_signals


@pytest.mark.parametrize(
    ("end", "reason"),
    [("reward = reach + held + near + 20", "rises to"), ("reward = held - 1", "falls to -1.000")],
)
def test_a_range_that_is_too_wide_is_refused_or_clipped(judge, end, reason):
    source = SOUND.replace("reward = reach + held + near + through", end)
    refused = judge(source)
    assert [reason in why for why in refused.reasons].count(True) == 1
    clipped = judge(source, range="clip")
    assert not any(reason in why for why in clipped.reasons)
    assert (clipped.lowest, clipped.highest) == (refused.lowest, refused.highest)
    assert clipped.gates.low <= clipped.random <= clipped.expert <= clipped.gates.top


def test_the_bonus_may_come_on_top(judge):
    source = SOUND.replace("near + through", "near + through + 2.9")
    assert judge(source).highest > 9
    assert judge(source).passed
    assert not judge(source, bonus=0.0).passed


@pytest.mark.parametrize("source", ["reward = 3", "reward = 9 - 2 * grasped - 3 * lifted"])
def test_the_expert_must_stand_out(judge, source):
    assert any("above a random policy" in reason for reason in judge(source).reasons)


def test_the_margin_is_what_is_asked(judge):
    gap = judge(SOUND).expert - judge(SOUND).random
    assert judge(SOUND, margin=gap - 0.01).passed
    assert not judge(SOUND, margin=gap + 0.01).passed


def test_a_program_that_the_cheat_fools_is_flagged(judge):
    found = judge(FOOLED)
    assert found.passed
    assert "without threading" in found.flags[0]
    refused = judge(FOOLED, audit="refuse")
    assert not refused.passed
    assert refused.reasons == found.flags[:1]
    assert refused.flags == found.flags[1:]


def test_the_cheat_does_not_lose_by_being_slow(judge):
    """The cheat's episodes last to the limit; a cost of time alone must not save a program."""
    slow = judge(f"{FOOLED} + 2 * (1 - elapsed) - 2", range="clip")
    assert slow.flags


def test_the_audit_can_be_passed_by_a_margin(judge):
    gap = judge(SOUND).expert - judge(SOUND).cheat
    assert not judge(SOUND, audit_margin=gap - 0.01).flags
    assert judge(SOUND, audit_margin=gap + 0.01).flags


@pytest.mark.parametrize(
    ("source", "share"),
    [
        ("reward = 3", 0.0),
        # Time passes by itself.
        ("reward = 9 * (1 - elapsed)", 0.0),
        ("reward = 2 * grasped + 2 * lifted", 0.0),
        ("reward = 9 * exp(-200 * distance(needle_tip, goal))", 0.0),
        ("reward = 9 * exp(-20 * distance(tool_midpoint, pickup_point))", 1.0),
    ],
)
def test_how_often_random_actions_are_paid(judge, source, share):
    found = judge(source)
    assert found.paid == pytest.approx(share, abs=0.08)
    assert any("of random steps are paid" in flag for flag in found.flags) == (share == 0)
    # It is never a reason to refuse.
    assert not any("random steps" in reason for reason in found.reasons)


def test_what_counts_as_paid_and_how_much_is_asked_are_settings(judge):
    assert not judge("reward = 3", paid=0.0).flags[1:]
    assert judge(SOUND, paid_by=5.0).paid == 0
    assert any("at least 99 %" in flag for flag in judge(SOUND, paid=0.99).flags)


def test_the_papers_image_rewards_are_hardly_ever_paid_and_its_text_reward_by_the_unit(judge):
    shipped = program_reward.RECORDINGS / "paper" / "rewards"
    found = [judge(path.read_text()) for path in shipped.glob("*/image.txt")]
    assert all(card.paid < 0.1 for card in found)
    assert all("of random steps are paid" in card.flags[-1] for card in found)
    text = (shipped / "any" / "text.txt").read_text()
    assert judge(text).paid > 0.5
    assert judge(text.replace("unit = 0.1", "unit = 0.05")).paid < 0.1


def test_the_papers_own_rewards_are_seen_through(judge):
    """Its text-only reward was gamed in training; of the others, one leaves the range."""
    shipped = program_reward.RECORDINGS / "paper" / "rewards"
    found = {
        f"{path.parent.name}/{path.stem}": judge(path.read_text())
        for path in shipped.glob("*/*.txt")
    }
    assert len(found) == 4
    assert found["any/text"].passed
    assert "touching the goal without threading" in found["any/text"].flags[0]
    assert found["any/text"].expert - found["any/text"].cheat < 0.1
    refused = {name: card.reasons for name, card in found.items() if not card.passed}
    assert list(refused) == ["dep_front+rgb_side/image"]
    assert ["rises to" in reason for reason in refused["dep_front+rgb_side/image"]] == [True]


def test_the_recorded_models_rewards_pass(judge):
    trained = program_reward.RECORDINGS / "claude_8210a79" / "rewards"
    found = {path.parent.name: judge(path.read_text()) for path in trained.glob("*/*.txt")}
    assert len(found) == 4
    assert all(card.passed and not card.flags for card in found.values())
    assert all(card.paid > 0.8 for card in found.values())
    shipped = program_reward.RECORDINGS / "claude" / "rewards"
    newer = [judge(path.read_text()) for path in shipped.glob("*/*.txt")]
    assert len(newer) == 10
    assert all(card.passed and card.paid > 0.4 for card in newer)


def test_a_program_that_pays_more_for_stopping_is_flagged(judge):
    """The paper's text reward pays more for the hoop's centre than for going through."""
    paper = (program_reward.RECORDINGS / "paper/rewards/any/text.txt").read_text()
    found = judge(paper)
    assert found.passed
    (said,) = [flag for flag in found.flags if "finishing the task" in flag]
    assert said.startswith("the teacher holding still at touched ends 0.")
    assert said.endswith(" above finishing the task")
    assert said in judge(paper, stop="refuse").reasons
    assert not any("finishing" in flag for flag in judge(SOUND).flags)
    assert any("finishing" in flag for flag in judge(SOUND, stop_margin=2.0).flags)


def test_the_human_reward_pays_no_more_for_stopping(quick, gates, seen):
    human = reference_reward(quick.definition)

    class Called:
        terms = tuple(human(seen.moments))

        def __call__(self, signals: Any) -> Any:
            return human(signals)

    program: Any = Called()
    found = card(program, quick, gates, seen)
    assert found.highest > 8
    assert not any("finishing" in flag for flag in found.flags)


def test_the_teacher_stops_where_facts_and_phases_say(quick, gates, seen):
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
    half, whole = seen.stopped["holding still at half of insert"]
    assert bool(half.lifted.all())
    away = torch.linalg.vector_norm(half.needle_tip - half.goal, dim=-1)
    assert float(away.min()) > 0.003
    assert float(away.max()) < 0.03


@pytest.fixture(scope="module")
def others(gates) -> dict[str, tuple[Settings, Gates, Trajectories]]:
    """Short trajectories of the other tasks."""
    few = replace(gates, episodes=2, random_signals=160, random_episodes=2, stop_episodes=1)
    found = {}
    for task in ("reach", "peg_transfer"):
        own = settings_from(composing.compose([f"task={task}", "engine.threads=1"], "check"))
        found[task] = own, few, collect(own, few)
    return found


def test_every_task_is_stopped_short(others):
    for own, _, seen in others.values():
        goal, stopped = own.definition.goal, seen.stopped
        assert f"holding still at half of {own.definition.phases[0].name}" in stopped
        assert all(not bool(getattr(short, goal).any()) for short, _ in stopped.values())
        assert all(bool(getattr(whole, goal).all()) for _, whole in stopped.values())


def test_trajectories_are_the_same_again(others):
    own, few, seen = others["reach"]
    assert bool((collect(own, few).moments == seen.moments).all())


def test_a_task_without_a_cheat_has_no_audit(others):
    own, few, seen = others["reach"]
    source = "reward = 9 * exp(-40 * distance(tool_midpoint, target))"
    program = language.compile_program(source, own.definition.signals)
    found = card(program, own, replace(few, audit="refuse"), seen)
    assert found.cheat is None
    assert found.passed
    assert found.expert > 8
    assert "cheat" not in str(found)
    json.dumps(found.as_dict(), allow_nan=False)


def test_another_tasks_cheat_is_seen_through_and_not_named(others, monkeypatch):
    own, few, seen = others["peg_transfer"]
    monkeypatch.setattr(writing, "collect", lambda *_: seen)
    rules = writing.program_rules(own, replace(few, audit="refuse"))
    fooled = rules.judge("reward = 9 * exp(-20 * distance(block_position, goal))")
    assert fooled.reason is not None
    assert fooled.reason.startswith("an episode that fails at the task ends")
    assert own.definition.cheating in fooled.card["reasons"][0]
    honest = rules.judge(
        "near = exp(-20 * distance(block_position, goal))\nreward = near * (8 if jaw > 0.6 else 5)"
    )
    assert honest.reason is None


def test_random_signals_are_wild_but_possible():
    signals = random_signals(4000, seed=0)
    for name, row in TABLE.items():
        value = getattr(signals, name)
        assert value.shape == (4000, *row.shape)
        assert value.dtype == (torch.bool if row.unit == "bool" else torch.float64)
        if row.unit == "bool":
            assert 0.4 < float(value.double().mean()) < 0.6
        elif row.unit == "m":
            assert 0.29 < float(value.abs().max()) <= 0.3
        elif row.unit == "1" and row.shape:
            torch.testing.assert_close(value.norm(dim=-1), torch.ones(4000, dtype=torch.float64))
    assert bool((random_signals(4000, seed=0) == signals).all())
    assert not bool((random_signals(4000, seed=1) == signals).all())


def test_a_bad_gate_is_refused_by_its_key():
    for change, said in (
        ("gates.range=cut", "gates.range: 'cut' is unknown; choose from refuse, clip"),
        ("gates.audit=no", "gates.audit: 'no' is unknown; choose from flag, refuse"),
        ("gates.episodes=0", "gates.episodes: 0 must be at least 1"),
        ("gates.paid=2", "gates.paid: 2.0 must be at most 1"),
        ("gates.paid_by=0", "gates.paid_by: 0.0 must be positive"),
        ("gates.low=20", "gates.low: 20.0 must be below"),
    ):
        with pytest.raises(ValueError, match=said):
            made([change])


# The command.

QUICK = [
    "gates.episodes=2",
    "gates.random_signals=200",
    "gates.random_episodes=2",
    "gates.stop_episodes=1",
    "engine.threads=1",
]


def check(*words: str) -> int:
    return main(["vlm", "check", *words])


def test_check_prints_the_card(tmp_path, capsys):
    file = tmp_path / "mine.txt"
    file.write_text(SOUND)
    assert check(str(file), *QUICK) == 0
    out = capsys.readouterr().out
    assert str(file) in out
    assert "verdict      passed" in out
    assert "% of random steps change it by 0.001 or more; at least 10 % is asked (flag)" in out
    assert len(out.splitlines()) < 25


def test_check_says_no_where_a_gate_does(tmp_path, capsys, seen, monkeypatch):
    monkeypatch.setattr("needlehoop.vlm.card.collect", lambda *_: seen)
    file = tmp_path / "mine.txt"
    file.write_text("reward = 40")
    assert check(str(file), "--json", *QUICK) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["passed"] is False
    assert found["highest"] == 40
    assert any("rises to 40" in reason for reason in found["reasons"])


def test_check_says_why_a_program_is_refused(tmp_path, capsys):
    file = tmp_path / "mine.txt"
    file.write_text("reward = 1\nimport os")
    assert check(str(file)) == 1
    out = capsys.readouterr().out
    assert f"{file}: line 2, column 1: Import is not in the language" in out
    assert check(str(file), "--json") == 1
    where = json.loads(capsys.readouterr().out)["refused"]
    assert (where["line"], where["column"]) == (2, 1)
    assert "Import is not in the language" in where["reason"]


@pytest.mark.full
def test_check_reads_a_program_in_another_unit(capsys):
    paid = {}
    for unit in ("null", "0.05", "0.1"):
        check("cams=[rgb_default]", "flavour=text", f"unit={unit}", "--json", *QUICK)
        paid[unit] = json.loads(capsys.readouterr().out)["paid"]
    assert paid["0.05"] < paid["0.1"] == paid["null"]


def test_a_mistake_in_the_command_is_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = ["cams=[rgb_default]", "flavour=text"]
    for words, said in (
        (["nowhere.txt"], "nowhere.txt"),
        (["a.txt", "b.txt"], "one file at a time"),
        ([], "name a file"),
        (["cams=[rgb_top]"], "rgb_top"),
        (["a.txt", "gates.range=cut"], "range: 'cut'"),
        (["a.txt", "gates.rnage=clip"], "rnage"),
        ([*text, "reward.unit=0.1"], "reward.unit=0.1: the program is judged"),
        ([*text, "unit=no"], "unit: 'no' is not a number"),
        ([*text, "recording=claude", "unit=0.1"], "no line such as"),
    ):
        assert check(*words) == 2
        error = capsys.readouterr().err.strip()
        assert error.startswith("needlehoop vlm check: ")
        assert said in error.splitlines()[-1]
