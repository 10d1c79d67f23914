"""The probe: frames, readers, scores, files and the command."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from needlehoop.cli import main as cli
from needlehoop.config import composing, strict
from needlehoop.envs.settings import Settings
from needlehoop.learning.algorithm_config import PpoConfig
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.networks import HeadConfig
from needlehoop.probe import frames, measuring
from needlehoop.probe.frames import KINDS, Frames, collect, phase_of, quantities
from needlehoop.probe.measuring import Episodes, Fit, Plan, camera_sets
from needlehoop.probe.report import agreements, ranking, ranking_figure
from needlehoop.probe.scores import (
    CONSTANT,
    TRUTH,
    ProbeResults,
    constant,
    errors,
    load,
    places,
    save,
)
from needlehoop.study.stats.statistics import Estimated, Interval
from needlehoop.tasks.contract import Phase
from needlehoop.tasks.registry import find

TARGETS = quantities(find("needle_hoop"))

TINY = ["image_size=16", "encoder.channels=[8]", "episodes.train=8", "episodes.held_out=8"]
TINY += ["episode.max_steps=40", "fit.updates=3", "fit.minibatch=32"]


@pytest.fixture(scope="module")
def seen(settings: Settings) -> Frames:
    small = replace(settings, cams=("rgb_default", "seg_front"), image_size=16, seed=5)
    return collect(small, 8, 3)


def test_frames_show_every_phase_of_every_kind_of_episode(seen):
    assert set(seen.phase.tolist()) == {0, 1, 2}
    assert set(seen.episode.tolist()) == set(range(8))
    counts = np.zeros((8, 3), dtype=int)
    np.add.at(counts, (seen.episode.numpy(), seen.phase.numpy()), 1)
    assert counts.max() == 3
    experts = [i for i in range(8) if KINDS[i % len(KINDS)] == "expert"]
    assert (counts[experts] == 3).all()
    # Nobody grasps by chance.
    assert counts[[i for i in range(8) if KINDS[i % len(KINDS)] == "random"], 1:].sum() == 0


def test_frames_say_where_things_are_relative_to_the_goal(seen):
    assert seen.points.shape == (len(seen), len(TARGETS.points), 3)
    tip = seen.points[:, TARGETS.points.index("needle_tip")].norm(dim=-1)
    assert tip.max() < 100, "millimetres on a table of a few centimetres"
    inserting = seen.phase == TARGETS.phases.index("insert")
    assert tip[inserting].min() < 12
    assert tip[seen.phase == 0].min() > 15
    assert torch.equal(seen.fact, seen.phase > 0)


def test_frames_are_the_pictures_of_their_moments(settings, seen):
    """The second run of a batch must meet the moments that the first one chose."""
    assert seen.images["rgb_default"].shape == (len(seen), 3, 16, 16)
    assert seen.images["seg_front"].shape == (len(seen), 3, 16, 16)
    again = collect(replace(settings, cams=("seg_front",), image_size=16, seed=5), 8, 3)
    assert torch.equal(again.images["seg_front"], seen.images["seg_front"])
    assert torch.equal(again.points, seen.points)
    # Held needles leave the table, so the pictures of the phases differ.
    means = [seen.images["seg_front"][seen.phase == p].float().mean(0) for p in range(3)]
    assert (means[0] - means[2]).abs().max() > 20


def test_an_episode_does_not_depend_on_how_many_there_are(settings, monkeypatch):
    monkeypatch.setattr(frames, "_BATCH", 4)
    blind = replace(settings, cams=(), seed=5)
    few, more = (collect(blind, n, 2) for n in (4, 6))
    same = more.episode < 4
    assert len(set(more.episode.tolist())) == 6
    assert torch.equal(more.points[same], few.points)


def test_what_is_read_off_follows_from_the_tasks_phases():
    assert TARGETS.points == ("needle_tip", "pickup_point", "tool_midpoint")
    assert (TARGETS.origin, TARGETS.fact) == ("goal", "grasped")
    assert TARGETS.names == (*TARGETS.points, "tool_to_pickup", "grasped")
    needed = {"reach": "tool_to_pickup", "lift": "pickup_point", "insert": "needle_tip"}
    assert TARGETS.needed == needed
    reach = quantities(find("reach"))
    assert (reach.points, reach.origin, reach.gaps) == (("tool_midpoint",), "target", {})
    assert reach.needed == {"approach": "tool_midpoint", "stay": "tool_midpoint"}


def test_a_task_without_two_places_a_phase_is_refused():
    odd = replace(find("reach"), phases=(Phase("turn", "near", ("target", "joints")),))
    with pytest.raises(ValueError, match="task reach has no phases between two places"):
        quantities(odd)


def test_a_moment_is_in_the_phase_after_the_last_fact_that_holds():
    grasped = torch.tensor([False, False, True, True, True])
    lifted = torch.tensor([False, True, False, True, True])
    threaded = torch.tensor([False, False, False, False, True])
    moment = SimpleNamespace(batch_size=[5], grasped=grasped, lifted=lifted, threaded=threaded)
    assert phase_of(TARGETS, moment).tolist() == [0, 0, 1, 2, 2]
    held = torch.tensor([False, True, True, True, True])
    high = torch.tensor([False, False, True, True, False])
    over = torch.tensor([True, False, False, True, True])
    block = SimpleNamespace(batch_size=[5], grasped=held, lifted=high, over=over)
    lowered = "the block that is lowered over its peg is being placed"
    assert phase_of(quantities(find("peg_transfer")), block).tolist() == [0, 1, 2, 3, 3], lowered


def _frames(points: torch.Tensor, phase: list[int], episode: list[int]) -> Frames:
    phases = torch.tensor(phase)
    return Frames({}, torch.zeros(len(phase), 1), points, phases > 0, phases, torch.tensor(episode))


def test_errors_are_distances_in_mm_by_episode_and_phase():
    truth = torch.zeros(4, 3, 3)
    shown = _frames(truth, [0, 0, 1, 2], [0, 0, 0, 1])
    points = torch.zeros(4, 3, 3)
    points[0, TARGETS.points.index("needle_tip")] = torch.tensor([3.0, 4.0, 0.0])
    points[0, TARGETS.points.index("tool_midpoint")] = torch.tensor([0.0, 2.0, 0.0])
    points[1, TARGETS.points.index("pickup_point")] = torch.tensor([0.0, 0.0, 6.0])
    facts = torch.tensor([False, True, True, True])
    means, counts = errors(TARGETS, shown, points, facts, 3)
    at = {name: i for i, name in enumerate(TARGETS.names)}
    reach = means[0, 0]
    assert reach[at["needle_tip"]] == 2.5
    assert reach[at["tool_midpoint"]] == 1.0
    assert reach[at["pickup_point"]] == 3.0
    assert reach[at["tool_to_pickup"]] == 4.0
    assert reach[at["grasped"]] == 0.5
    assert counts.tolist() == [[2, 1, 0], [0, 0, 1], [0, 0, 0]]
    assert np.isnan(means[2]).all()
    assert np.isnan(means[1, 0]).all()


def test_the_constant_is_each_phases_mean_and_needs_to_have_seen_it():
    points = torch.arange(4.0).view(4, 1, 1).expand(4, 3, 3)
    learnt = _frames(points, [0, 0, 1, 2], [0, 0, 0, 0])
    means, _ = constant(TARGETS, learnt, _frames(torch.zeros(3, 3, 3), [0, 1, 2], [0, 0, 0]))
    assert means[:, 0, 0].tolist() == [0.5, 2.0, 3.0]
    with pytest.raises(ValueError, match=r"episodes\.train: none comes to the phase insert"):
        constant(TARGETS, _frames(points[:3], [0, 0, 1], [0, 0, 0]), learnt)


def _errors(by_phase: list[float], episodes: int, spread: float, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    mean = np.full((episodes, 3, len(TARGETS.names)), 99.0)
    for p, phase in enumerate(TARGETS.phases):
        noise = generator.uniform(-spread, spread, episodes)
        mean[:, p, TARGETS.names.index(TARGETS.needed[phase])] = by_phase[p] + noise
    return mean


def _results(errors: list[np.ndarray], blind: list[np.ndarray]) -> ProbeResults:
    """Of one camera set, ``rgb``, seed by seed."""
    return ProbeResults(TARGETS, {"rgb": np.stack(errors), CONSTANT: np.stack(blind)})


def test_the_score_is_the_mean_over_phases_of_what_each_needs():
    blind = _errors([10.0, 20.0, 40.0], 6, 0.0, 0)
    results = _results([_errors([5.0, 5.0, 40.0], 6, 0.0, 0)], [blind])
    score = results.score("rgb")
    assert score.value == pytest.approx((0.5 + 0.75 + 0.0) / 3)
    assert (score.interval.low, score.interval.high) == pytest.approx((score.value,) * 2)
    assert results.score(CONSTANT).value == 0
    two = _results([_errors([0.0] * 3, 6, 0.0, 0), blind], [blind, blind])
    assert two.score("rgb").value == pytest.approx(0.5)
    assert two.scores_by_seed("rgb") == [1, 0]
    # An episode without a phase counts in the others.
    few, blind = (_errors([value] * 3, 4, 0.0, 0) for value in (5.0, 10.0))
    few[1:, 2], few[0, 2], blind[0, 2] = 2.0, np.nan, np.nan
    assert _results([few], [blind]).score("rgb").value == pytest.approx((0.5 + 0.5 + 0.8) / 3)
    # Intervals narrow with episodes, and hold the truth.
    few, many = (
        _results([errors], [errors]).error("rgb", "reach", TARGETS.needed["reach"]).interval
        for errors in (_errors([5.0] * 3, n, 2.0, 1) for n in (8, 800))
    )
    assert many.high - many.low < 0.3 < few.high - few.low
    assert many.low < 5 < many.high


def test_what_cannot_be_separated_shares_a_place():
    scores = {
        "a": Estimated(0.9, Interval(0.85, 0.95)),
        "b": Estimated(0.8, Interval(0.75, 0.86)),
        "c": Estimated(0.74, Interval(0.70, 0.78)),
        "d": Estimated(0.1, Interval(0.0, 0.2)),
    }
    assert places(scores) == {"a": (1, 2), "b": (1, 3), "c": (2, 3), "d": (4, 4)}


def test_combinations_are_names_with_plus(settings):
    sets = (("dep_front", "seg_side"), ("rgb_front",))
    assert camera_sets(["dep_front+seg_side", "rgb_front"], settings) == sets
    for names, match in (
        ([], "cams: give camera sets"),
        (["rgb_default", "rgb_default"], "each once"),
        (["rgb_top"], "view: 'top' is unknown; choose from default, front, side"),
    ):
        with pytest.raises(ValueError, match=match):
            camera_sets(names, settings)


def _plan(settings: Settings, folder: Path, sets: list[str], updates: int, **more) -> Plan:
    ppo = strict.value(composing.compose((), "probe"), "algo", PpoConfig)
    return Plan(
        env=settings,
        camera_sets=camera_sets(sets, settings),
        encoder=EncoderConfig("tiny", 4, (16,), 1),
        algo=replace(ppo, network=HeadConfig(64, 1, 1.0, True, ())),
        episodes=Episodes(**{"train": 60, "held_out": 24, "per_phase": 4, **more}),
        fit=Fit(updates, 64, 2e-3),
        seeds=1,
        results=str(folder),
        study="probe",
        device="cpu",
        precision="fp32",
    )


@pytest.mark.full
def test_a_camera_that_sees_the_needle_beats_one_turned_away(settings, tmp_path):
    """The synthetic case: the same camera, and one that looks at the empty air behind it."""
    away = replace(settings.views["default"], target=(0.0, -3.0, 0.5))
    scene = replace(settings, views={**settings.views, "away": away}, image_size=32)
    plan = _plan(scene, tmp_path, ["seg_away", "seg_default"], 150)
    measuring.probe(plan, tmp_path)
    results = load(tmp_path, TARGETS)
    assert results.ranked == ["seg_default", "seg_away"]
    assert results.places == {"seg_default": (1, 1), "seg_away": (2, 2)}
    assert results.score("seg_default").interval.low > 0.15
    # The frames of one phase look alike to it: it can't be better than a constant.
    assert results.score("seg_away").interval.high < 0.1
    assert results.score(CONSTANT) == Estimated(0.0, Interval(0.0, 0.0))
    assert results.score(TRUTH).value > results.score("seg_default").value


def _run(tmp_path: Path, *words: str) -> int:
    return cli.main(["probe", f"results={tmp_path}", *TINY, *words])


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_the_command_measures_then_shows_what_is_there(tmp_path, capsys):
    words = ["cams=rgb_default,dep_front+seg_side", "seeds=2"]
    assert _run(tmp_path, *words) == 2
    error = capsys.readouterr().err
    assert f"compute: {tmp_path}/probe lacks rgb_default; compute=true" in error
    assert not list(tmp_path.iterdir())
    assert _run(tmp_path, *words, "compute=true") == 0
    measured = capsys.readouterr().out
    assert "dep_front+seg_side" in measured
    assert "true state" in measured
    folder = tmp_path / "probe"
    names = {"constant.csv", "signals.csv", "rgb_default.csv", "dep_front+seg_side.csv"}
    assert {file.name for file in (folder / "seed1").iterdir()} == names
    rows = _rows(folder / "seed0" / "rgb_default.csv")
    assert [row["kind"] for row in rows[:4]] == list(KINDS)
    assert {"config.yaml", "manifest.json", "ranking.md", "ranking.png"} <= {
        file.name for file in folder.iterdir()
    }
    assert _run(tmp_path, *words) == 0
    assert capsys.readouterr().out == measured
    assert _run(tmp_path, "cams=seg_side", "compute=true") == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert _run(tmp_path, *words, "task=reach/standard") == 2
    assert "is not of a probe of reach" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bits_beside_other_sets_and_threads(settings, tmp_path):
    small = replace(settings, image_size=16, engine=replace(settings.engine, threads=1))
    more = {"train": 8, "held_out": 8}
    alone = _plan(small, tmp_path, ["seg_side"], 2, **more)
    beside = replace(alone, env=settings, camera_sets=(("rgb_default",), ("seg_side",)))
    beside = replace(beside, env=replace(small, engine=replace(small.engine, threads=2)))
    for name, plan in (("alone", alone), ("beside", beside)):
        measuring.probe(plan, tmp_path / name)
    first, second = (tmp_path / name / "seed0/seg_side.csv" for name in ("alone", "beside"))
    assert first.read_bytes() == second.read_bytes()


def test_tables_hold_the_papers_lists_against_the_probe(tmp_path):
    """A probe that finds the paper's own returns agrees with them wholly."""
    from needlehoop.study.data import paper

    errors = {CONSTANT: 10.0, TRUTH: 0.1}
    errors |= {name: 10.0 - value for name, value in paper.measured().items()}
    for name, value in errors.items():
        means = _errors([value] * 3, 12, 0.0, 0)
        save(tmp_path / f"seed0/{name}.csv", TARGETS, means, np.ones((12, 3), dtype=int))
    results = load(tmp_path, TARGETS)
    table = agreements(results).rows
    measured = table[table["against"] == "the paper's measured"]
    assert measured["n"].tolist() == ["5", "5", "6", "14"]
    assert measured["tau-b"].tolist()[:3] == ["1.00"] * 3
    assert set(measured["best found"]) == set(measured["worst found"]) == {"yes"}
    # As the paper's VLM agrees with the paper's own measurements.
    vlm = table[table["against"] == "the paper's VLM"]
    assert vlm["tau-b"].tolist() == ["0.60", "0.60", "0.60"]
    assert ranking(results).rows["cameras"].tolist()[::15] == ["dep_front+seg_side", "constant"]
    axes = ranking_figure(results).axes
    assert axes[0].get_yticklabels()[0].get_text() == "dep_front+seg_side"
    results.targets = replace(TARGETS, task="reach")
    assert agreements(results).rows.empty


def test_the_shipped_probe_is_shown_with_its_numbers(tmp_path):
    shipped = Path(__file__).parents[2] / "results" / "probe"
    copy = shutil.copytree(shipped, tmp_path / "probe")
    assert cli.main(["probe", f"results={tmp_path}"]) == 0
    for name in ("ranking.csv", "ranking.md"):
        assert (copy / name).read_bytes() == (shipped / name).read_bytes()
