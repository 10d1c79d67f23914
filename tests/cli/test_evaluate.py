"""``needlehoop evaluate``: a run's own evaluation, and those beside it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import torch
import yaml
from tiny_runs import PLACE, TINY, composed, contents, run_composed, table

import needlehoop
from needlehoop.cli.main import main
from needlehoop.config.changing import changed
from needlehoop.learning import evaluate as evaluating
from needlehoop.runs.shipped import CONF


@pytest.fixture
def run(tiny_run, tmp_path) -> Path:
    return shutil.copytree(tiny_run, tmp_path / "seed0")


def evaluated(run: Path, *words: str, capsys) -> dict:
    assert main(["evaluate", str(run), *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "name", "changed"),
    [
        (["seed=7"], "seed-7", None),
        (["disturb.robot.lost=0.5", "as=a b"], "a b", {"disturb.robot.lost": 0.5}),
        (["reward.success=2", "seed=7"], "reward.success-2+seed-7", {"reward.success": 2}),
    ],
)
def test_another_evaluation_has_a_folder_of_its_own(run, capsys, words, name, changed):
    before = contents(run)
    assert main(["evaluate", str(run), *words]) == 0
    output = capsys.readouterr().out
    after = contents(run)
    place = f"evaluations/{name}/evaluation.json"
    evaluation = json.loads(after.pop(place))
    assert evaluation.get("changed") == changed
    assert after == before
    assert f"written      {run / place}" in output
    assert ("changed      " in output) == bool(changed)


def test_a_variant_of_the_task_is_what_it_is_in_training(run, capsys):
    evaluation = evaluated(run, "task=wide", capsys=capsys)
    options = yaml.safe_load((CONF / "task/wide.yaml").read_text())
    keys = {key for key in options if key != "defaults"}
    assert {key.removeprefix("task.") for key in evaluation["changed"]} == keys
    graded = evaluated(run, "disturb=mild", capsys=capsys)["changed"]
    assert graded["disturb.robot.lost"] > 0
    # The same again leaves the same.
    place = run / "evaluations/disturb-mild"
    assert evaluated(run, "disturb=mild", capsys=capsys)["changed"] == graded
    assert sorted(path.name for path in place.iterdir()) == ["evaluation.json"]
    # What a run has already changes nothing.
    assert "changed" not in evaluated(run, "task=standard", "engine.threads=2", capsys=capsys)
    assert not (run / "evaluations/task-standard").exists()


def test_the_runs_own_evaluation_stays_as_it_is(run, capsys):
    before = contents(run)
    assert main(["evaluate", str(run)]) == 0
    assert f"the same as  {run / 'evaluation.json'}" in capsys.readouterr().out
    assert contents(run) == before
    # Another reward pays for the same episodes.
    own = json.loads(before["evaluation.json"])
    rescored = evaluated(run, "reward=human", capsys=capsys)
    assert own["return"] == own["success"]
    assert rescored["return_human"] == pytest.approx(own["return_human"])
    assert rescored["return"] == pytest.approx(own["return_human"])
    # Of the same agent and the same episodes: a simulator has changed since, say.
    other = {**own, "return": 7.0}
    (run / "evaluation.json").write_text(json.dumps(other))
    evaluation = evaluated(run, capsys=capsys)
    assert json.loads((run / "evaluation.json").read_text()) == other
    assert json.loads((run / "evaluations/again/evaluation.json").read_text()) == evaluation
    # A run that was trained on since has a new one; a run that has none, its first.
    (run / "evaluation.json").write_text(json.dumps({**other, "steps_trained": 8}))
    assert evaluated(run, capsys=capsys) == json.loads((run / "evaluation.json").read_text())
    assert json.loads((run / "evaluation.1.json").read_text())["steps_trained"] == 8
    (run / "evaluation.json").unlink()
    assert evaluated(run, capsys=capsys) == json.loads((run / "evaluation.json").read_text())


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("cams=[rgb_front]", "cams: the agent's networks take what the run sees, []"),
        ("task=reach", "task: the run's is needle_hoop; choose from near, standard"),
        ("episodse=3", "episodse: unknown key; choose from as, device"),
        ("seed=0", "seed: the run was trained on 0"),
    ],
)
def test_what_may_not_be_changed_is_refused_in_a_line(run, capsys, word, message):
    before = contents(run)
    assert main(["evaluate", str(run), word]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert contents(run) == before


def test_an_option_takes_the_values_that_are_typed_for_it(tiny_run):
    recorded = yaml.safe_load((tiny_run / "config.yaml").read_text())
    values, changes = changed(
        recorded, ["reward=file", "reward.path=mine.txt", "task.hoop_tube=0.002"]
    )
    assert (values["reward"]["kind"], values["reward"]["path"]) == ("file", "mine.txt")
    assert changes["task.hoop_tube"] == 0.002
    assert values["task"]["needle_radius"] == recorded["task"]["needle_radius"]


def test_any_option_of_a_group_that_a_run_knows_nothing_of_is_a_condition(tiny_run):
    """A run from before there was such a group is as it is by default."""
    recorded = yaml.safe_load((tiny_run / "config.yaml").read_text())
    without = {key: value for key, value in recorded.items() if key != "picture"}
    values, changes = changed(without, ["picture.azimuth=7"])
    assert values["picture"] == {**recorded["picture"], "azimuth": 7}
    assert changes == {}
    without = {key: value for key, value in recorded.items() if key != "episode"}
    values, changes = changed(without, ["episode.grasp=friction"])
    assert changes == {"episode.grasp": "friction"}
    assert values["episode"]["max_steps"] == 100


def test_text_of_a_run_is_no_reference(tiny_run, monkeypatch):
    monkeypatch.setenv("SECRET", "42")
    recorded = yaml.safe_load((tiny_run / "config.yaml").read_text())
    recorded["study"] = "${oc.env:SECRET}"
    values, _ = changed(recorded, ["episode.grasp=friction"])
    assert values["study"] == "${oc.env:SECRET}"


def test_watch_flies_under_other_conditions_and_says_so(run, capsys, elsewhere):
    before = contents(run)
    words = ["episode.max_steps=2", "episodes=1", "video_episodes=1"]
    assert main(["watch", str(run), *words, "policy=best"]) == 0
    output = capsys.readouterr().out
    assert "policy       best, after 16 steps\nchanged      episode.max_steps=2\n" in output
    assert "length       2 steps" in output
    assert contents(run) == before


def test_environments_and_policies_of_a_run(run):
    env, wide = (
        needlehoop.make_env_of(run, num_envs=2, overrides=words)
        for words in ((), ["task=wide", "episode.max_steps=2"])
    )
    assert env.settings.episode.max_steps == 3
    assert wide.settings.episode.max_steps == 2
    assert wide.settings.task.needle_yaw_range > env.settings.task.needle_yaw_range
    with pytest.raises(ValueError, match="image_size: the agent's networks"):
        needlehoop.make_env_of(run, overrides=["image_size=32"])
    last, best = (needlehoop.load_policy(run, policy=name) for name in ("last", "best"))
    assert last.origin == f"last, after 24 steps, of {run}"
    assert repr(best) == f"Policy(best, after 16 steps, of {run})"
    seen = env.reset()
    assert not torch.equal(last(seen), best(seen))
    assert torch.equal(last(seen), needlehoop.load_policy(run)(seen))
    alone = needlehoop.load_policy(run / "best.safetensors")
    assert torch.equal(alone(seen), best(seen))
    with pytest.raises(ValueError, match="is a policy already"):
        needlehoop.load_policy(run / "best.safetensors", policy="best")


def test_the_best_policy_is_that_of_the_best_evaluation(elsewhere, monkeypatch):
    """Success first, then the return, then the later."""
    marks = iter([(0.5, 1.0), (0.5, 2.0), (0.4, 9.0), (0.5, 2.0), (0.5, 1.9)])
    real = evaluating.on_the_way

    def note(job, agent):
        success, value = next(marks)
        return {**real(job, agent), "success": success, "return": value}

    monkeypatch.setattr("needlehoop.training.loop.on_the_way", note)
    run_composed(composed(*TINY, "steps=40", "evaluation.every=1"))
    run = Path("results") / PLACE
    assert [row["success"] for row in table(run / "evaluations.csv")][3] == "0.5"
    assert evaluating.which_policy(evaluating.Run(run), "best") == ("best", 32)


def test_the_policy_is_the_last_or_else_the_best(elsewhere, capsys):
    run = Path("results") / PLACE
    run_composed(composed(*TINY))
    assert {path.stem for path in run.glob("*.safetensors")} == {"policy", "best"}
    # As it is copied to others.
    (run / "checkpoint.pt").unlink()
    for kept, gone in (("last", "best"), ("best", "policy")):
        (run / f"{gone}.safetensors").rename(run / "aside")
        capsys.readouterr()
        assert evaluated(run, "episodes=1", capsys=capsys)["policy"] == kept
        assert needlehoop.load_policy(run).origin.startswith(kept)
        if kept == "last":
            assert main(["evaluate", str(run), "policy=best"]) == 2
            assert "has no best.safetensors" in capsys.readouterr().err
        (run / "aside").rename(run / f"{gone}.safetensors")


def test_evaluations_say_how_the_sampled_policy_does(tiny_run):
    """Drawn with the policy's own deviation, from numbers that no other environment changes."""
    from dataclasses import replace

    from needlehoop.learning.job import typed_job
    from needlehoop.runs.run import Run

    run = Run.open(tiny_run)
    job = typed_job(run.config())
    agent = evaluating.load_agent(run, job, torch.device("cpu"))
    settings = replace(job.env, seed=7)
    few, many = (evaluating.evaluate(settings, agent, n, sampled=True) for n in (2, 4))
    assert torch.equal(few.potential, many.potential[:2])
    mean = evaluating.evaluate(settings, agent, 2)
    assert not torch.equal(few.human, mean.human)
    with torch.no_grad():
        agent.actor.head.log_sigma.fill_(-30.0)
    assert torch.allclose(evaluating.evaluate(settings, agent, 2, sampled=True).human, mean.human)
    rows = table(tiny_run / "evaluations.csv")
    assert all(0 <= float(row["success_sampled"]) <= 1 for row in rows)
    assert "success_sampled" in json.loads((tiny_run / "evaluation.json").read_text())
