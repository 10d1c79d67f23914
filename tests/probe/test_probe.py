"""The probe: frames, readers, scores, files and the command."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from needlehoop.cli import main as cli
from needlehoop.config import composing
from needlehoop.envs.settings import Settings
from needlehoop.learning.encoder import EncoderConfig
from needlehoop.learning.networks import HeadConfig
from needlehoop.probe import frames, measuring
from needlehoop.probe.folder import Folder
from needlehoop.probe.frames import KINDS, Frames, collect, phase_of, quantities
from needlehoop.probe.plan import CONSTANT, TRUTH, Episodes, Fit, Grid, Plan, camera_sets
from needlehoop.probe.report import all_tables, ranking_figure, view_map
from needlehoop.probe.scores import ProbeResults, constant, errors, places
from needlehoop.study.stats.statistics import Estimated, Interval
from needlehoop.tasks.contract import Phase
from needlehoop.tasks.registry import built_in, find

ASKED = quantities(find("needle_hoop"))

TINY = ["image_size=16", "encoder.channels=[8]", "episodes.train=8", "episodes.held_out=8"]
TINY += ["episode.max_steps=40", "fit.updates=3", "fit.minibatch=32"]


@pytest.fixture(scope="module")
def seen(settings: Settings) -> Frames:
    small = replace(settings, cams=("rgb_default", "seg_front"), image_size=16, seed=5)
    return collect(small, 8, 3, lambda _: None)


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
    assert seen.points.shape == (len(seen), len(ASKED.points), 3)
    tip = seen.points[:, ASKED.points.index("needle_tip")].norm(dim=-1)
    assert tip.max() < 100, "millimetres on a table of a few centimetres"
    inserting = seen.phase == ASKED.phases.index("insert")
    assert tip[inserting].min() < 12
    assert tip[seen.phase == 0].min() > 15
    assert torch.equal(seen.fact, seen.phase > 0)


def test_frames_are_the_pictures_of_their_moments(settings, seen):
    """The second run of a batch must meet the moments that the first one chose."""
    assert seen.images["rgb_default"].shape == (len(seen), 3, 16, 16)
    assert seen.images["seg_front"].shape == (len(seen), 3, 16, 16)
    again = collect(
        replace(settings, cams=("seg_front",), image_size=16, seed=5), 8, 3, lambda _: None
    )
    assert torch.equal(again.images["seg_front"], seen.images["seg_front"])
    assert torch.equal(again.points, seen.points)
    # Held needles leave the table, so the pictures of the phases differ.
    means = [seen.images["seg_front"][seen.phase == p].float().mean(0) for p in range(3)]
    assert (means[0] - means[2]).abs().max() > 20


def test_an_episode_does_not_depend_on_how_many_there_are(settings, monkeypatch):
    monkeypatch.setattr(frames, "_BATCH", 4)
    blind = replace(settings, cams=(), seed=5)
    few, more = (collect(blind, n, 2, lambda _: None) for n in (4, 6))
    same = more.episode < 4
    assert len(set(more.episode.tolist())) == 6
    assert torch.equal(more.points[same], few.points)


def test_what_is_read_off_follows_from_the_tasks_phases():
    assert ASKED.points == ("needle_tip", "pickup_point", "tool_midpoint")
    assert (ASKED.origin, ASKED.fact) == ("goal", "grasped")
    assert ASKED.names == (*ASKED.points, "tool_to_pickup", "grasped")
    wanted = {"reach": "tool_to_pickup", "lift": "pickup_point", "insert": "needle_tip"}
    assert ASKED.needed == wanted
    reach = quantities(find("reach"))
    assert (reach.points, reach.origin, reach.gaps) == (("tool_midpoint",), "target", {})
    assert reach.needed == {"approach": "tool_midpoint", "stay": "tool_midpoint"}


@pytest.mark.parametrize("name", built_in())
def test_each_phase_of_each_task_needs_something_that_is_read_off(name):
    asked = quantities(find(name))
    assert asked.phases == tuple(phase.name for phase in find(name).phases)
    assert set(asked.needed.values()) <= {*asked.points, *asked.gaps}
    assert {point for gap in asked.gaps.values() for point in gap} <= {*asked.points}
    assert len(set(asked.names)) == len(asked.names)


def test_ways_of_one_short_name_get_long_ones():
    phases = (
        Phase("one", "grasped", ("tool_midpoint", "pickup_point")),
        Phase("two", "grasped", ("tool_midpoint", "pickup_point")),
        Phase("three", "lifted", ("wrist_pos", "needle_tip")),
        Phase("four", "threaded", ("tool_midpoint", "goal")),
    )
    task = replace(find("needle_hoop"), phases=phases)
    assert [*quantities(task).gaps] == ["tool_to_pickup", "wrist_to_needle"]
    other = Phase("three", "lifted", ("tool_midpoint", "pickup_other"))
    things = {**task.things, "pickup_other": task.signals["goal"]}
    task = replace(task, things=things, phases=(*phases[:2], other, phases[3]))
    assert quantities(task).gaps == {
        "tool_to_pickup": ("tool_midpoint", "pickup_point"),
        "tool_midpoint_to_pickup_other": ("tool_midpoint", "pickup_other"),
    }


@pytest.mark.parametrize(
    ("phases", "match"),
    [
        ((), "task reach has no phases"),
        ((Phase("turn", "near", ("target", "joints")),), "phase turn: no two places: target, jo"),
        ((Phase("rest", "near", ("target", "target")),), "phase rest: no two places"),
    ],
)
def test_a_task_that_gives_nothing_to_read_off_is_refused(phases, match):
    with pytest.raises(ValueError, match=match):
        quantities(replace(find("reach"), phases=phases))


def test_a_moment_is_in_the_phase_after_the_last_fact_that_holds():
    grasped = torch.tensor([False, False, True, True, True])
    lifted = torch.tensor([False, True, False, True, True])
    threaded = torch.tensor([False, False, False, False, True])
    moment = SimpleNamespace(batch_size=[5], grasped=grasped, lifted=lifted, threaded=threaded)
    assert phase_of(ASKED, moment).tolist() == [0, 0, 1, 2, 2]
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
    said = torch.zeros(4, 3, 3)
    said[0, ASKED.points.index("needle_tip")] = torch.tensor([3.0, 4.0, 0.0])
    said[0, ASKED.points.index("tool_midpoint")] = torch.tensor([0.0, 2.0, 0.0])
    said[1, ASKED.points.index("pickup_point")] = torch.tensor([0.0, 0.0, 6.0])
    facts = torch.tensor([False, True, True, True])
    means, counts = errors(ASKED, shown, said, facts, 3)
    at = {name: i for i, name in enumerate(ASKED.names)}
    reach = means[0, 0]
    assert reach[at["needle_tip"]] == 2.5
    assert reach[at["tool_midpoint"]] == 1.0
    assert reach[at["pickup_point"]] == 3.0
    assert reach[at["tool_to_pickup"]] == 4.0
    assert reach[at["grasped"]] == 0.5
    assert counts.tolist() == [[2, 1, 0], [0, 0, 1], [0, 0, 0]]
    assert np.isnan(means[2]).all()
    assert np.isnan(means[1, 0]).all()


def test_both_points_off_by_the_same_leaves_the_gap_right():
    shown = _frames(torch.zeros(1, 3, 3), [0], [0])
    means, _ = errors(ASKED, shown, torch.full((1, 3, 3), 5.0), torch.tensor([False]), 1)
    assert means[0, 0, ASKED.names.index("tool_to_pickup")] == 0
    assert means[0, 0, 0] > 8


def test_the_constant_is_each_phases_mean_and_needs_to_have_seen_it():
    points = torch.arange(4.0).view(4, 1, 1).expand(4, 3, 3)
    learnt = _frames(points, [0, 0, 1, 2], [0, 0, 0, 0])
    said, _ = constant(ASKED, learnt, _frames(torch.zeros(3, 3, 3), [0, 1, 2], [0, 0, 0]))
    assert said[:, 0, 0].tolist() == [0.5, 2.0, 3.0]
    with pytest.raises(ValueError, match=r"episodes\.train: none comes to the phase insert"):
        constant(ASKED, _frames(points[:3], [0, 0, 1], [0, 0, 0]), learnt)


def _errors(by_phase: list[float], episodes: int, spread: float, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    mean = np.full((episodes, 3, len(ASKED.names)), 99.0)
    for p, phase in enumerate(ASKED.phases):
        noise = generator.uniform(-spread, spread, episodes)
        mean[:, p, ASKED.names.index(ASKED.needed[phase])] = by_phase[p] + noise
    return mean


def _results(found: list[np.ndarray], blind: list[np.ndarray]) -> ProbeResults:
    """Of one camera set, ``rgb``, seed by seed."""
    return ProbeResults(ASKED, {"rgb": np.stack(found), CONSTANT: np.stack(blind)})


def test_the_score_is_the_mean_over_phases_of_what_each_needs():
    blind = _errors([10.0, 20.0, 40.0], 6, 0.0, 0)
    results = _results([_errors([5.0, 5.0, 40.0], 6, 0.0, 0)], [blind])
    found = results.score("rgb")
    assert found.value == pytest.approx((0.5 + 0.75 + 0.0) / 3)
    assert (found.interval.low, found.interval.high) == pytest.approx((found.value,) * 2)
    assert results.score(CONSTANT).value == 0
    two = _results([_errors([0.0] * 3, 6, 0.0, 0), blind], [blind, blind])
    assert two.score("rgb").value == pytest.approx(0.5)
    assert two.scores_by_seed("rgb") == [1, 0]


def test_intervals_narrow_with_episodes_and_hold_the_truth():
    few, many = (
        _results([own], [own]).error("rgb", "reach", ASKED.needed["reach"]).interval
        for own in (_errors([5.0] * 3, n, 2.0, 1) for n in (8, 800))
    )
    assert many.high - many.low < 0.3 < few.high - few.low
    assert many.low < 5 < many.high
    held = 0
    for seed in range(60):
        own = _errors([5.0] * 3, 30, 2.0, seed)
        found = _results([own], [own]).error("rgb", "lift", ASKED.needed["lift"]).interval
        held += found.low < 5 < found.high
    assert 49 <= held <= 60, "95 % intervals, less what a bootstrap of 30 falls short"


def test_an_episode_without_a_phase_counts_in_the_others():
    found, blind = _errors([5.0] * 3, 4, 0.0, 0), _errors([10.0] * 3, 4, 0.0, 0)
    for one in (found, blind):
        one[0, 2] = np.nan
    found[1:, 2] = 2.0
    results = _results([found], [blind])
    assert results.score("rgb").value == pytest.approx((0.5 + 0.5 + 0.8) / 3)


def test_what_cannot_be_separated_shares_a_place():
    scores = {
        "a": Estimated(0.9, Interval(0.85, 0.95)),
        "b": Estimated(0.8, Interval(0.75, 0.86)),
        "c": Estimated(0.74, Interval(0.70, 0.78)),
        "d": Estimated(0.1, Interval(0.0, 0.2)),
    }
    assert places(scores) == {"a": (1, 2), "b": (1, 3), "c": (2, 3), "d": (4, 4)}


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ([], "nothing to probe"),
        (["rgb_default", "rgb_default"], "rgb_default is named twice"),
        (["rgb_default+rgb_default"], "named twice"),
        (["rgb_top"], "view: 'top' is unknown; choose from default, front, side"),
        (["x_front"], "rendering: 'x' is unknown"),
        ([[]], "nothing to probe"),
    ],
)
def test_bad_combinations_are_named(settings, given, match):
    with pytest.raises(ValueError, match=match):
        camera_sets(given, settings)


def test_combinations_are_names_with_plus_or_lists(settings):
    wanted = (("dep_front", "seg_side"), ("rgb_front",))
    assert camera_sets(["dep_front+seg_side", "rgb_front"], settings) == wanted
    assert camera_sets("dep_front+seg_side,rgb_front", settings) == wanted
    assert camera_sets([["dep_front", "seg_side"], ["rgb_front"]], settings) == wanted


def _plan(settings: Settings, folder: Path, given: list[str], updates: int, **more) -> Plan:
    return Plan(
        env=settings,
        camera_sets=camera_sets(given, settings),
        encoder=EncoderConfig("tiny", 4, (16,), 1),
        heads=HeadConfig(64, 1, 1.0, True, ()),
        episodes=Episodes(**{"train": 60, "held_out": 24, "per_phase": 4, **more}),
        fit=Fit(updates, 64, 2e-3),
        seeds=1,
        results=str(folder),
        study="probe",
        overwrite=False,
        device="cpu",
        precision="fp32",
    )


@pytest.mark.full
def test_a_camera_that_sees_the_needle_beats_one_turned_away(settings, tmp_path):
    """The synthetic case: the same camera, and one that looks at the empty air behind it."""
    away = replace(settings.views["default"], target=(0.0, -3.0, 0.5))
    scene = replace(settings, views={**settings.views, "away": away}, image_size=32)
    plan = _plan(scene, tmp_path, ["seg_away", "seg_default"], 150)
    folder = Folder(tmp_path / "probe", ASKED, {"fit": 1}, False)
    measuring.probe(plan, folder)
    found = folder.results(1)
    assert found.ranked == ("seg_default", "seg_away")
    assert found.places == {"seg_default": (1, 1), "seg_away": (2, 2)}
    assert found.score("seg_default").interval.low > 0.15
    # The frames of one phase look alike to it: it can't be better than a constant.
    assert found.score("seg_away").interval.high < 0.1
    assert found.score(CONSTANT) == Estimated(0.0, Interval(0.0, 0.0))
    assert found.score(TRUTH).value > found.score("seg_default").value


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The results of a probe of two camera sets by one seed; tests copy it."""
    results = tmp_path_factory.mktemp("whole")
    assert _run(results, "cams=rgb_default,seg_side", "seeds=1", "engine.threads=2") == 0
    return results


@pytest.fixture
def probed(whole, tmp_path) -> Path:
    return shutil.copytree(whole, tmp_path, dirs_exist_ok=True)


def _run(tmp_path: Path, *words: str) -> int:
    return cli.main(["probe", f"results={tmp_path}", "compute=true", *TINY, *words])


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _files(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def test_the_command_writes_tables_figure_and_plain_files(tmp_path, capsys):
    assert _run(tmp_path, "cams=rgb_default,dep_front+seg_side") == 0
    out = capsys.readouterr().out
    assert "dep_front+seg_side" in out
    assert "true state" in out
    assert "seed 0  seed 1" in out
    folder = tmp_path / "probe"
    names = {"constant.csv", "signals.csv", "rgb_default.csv", "dep_front+seg_side.csv"}
    assert {file.name for file in (folder / "seed1").iterdir()} == names
    for name in ("ranking.png", "ranking.md", "phases.csv", "agreement.csv"):
        assert (folder / name).stat().st_size > 100
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["memory_gb"] > 0
    rows = _rows(folder / "seed0" / "rgb_default.csv")
    assert [row["kind"] for row in rows[:4]] == list(KINDS)
    assert not list(folder.rglob("*.partial"))


@pytest.mark.parametrize("task", ["reach", pytest.param("peg_transfer", marks=pytest.mark.full)])
@pytest.mark.full
def test_the_command_probes_any_task(tmp_path, capsys, task):
    words = ["cams=rgb_default", "seeds=2", f"task={task}/standard", "episode.max_steps=150"]
    assert _run(tmp_path, *words) == 0
    asked, folder = quantities(find(task)), tmp_path / "probe"
    row = _rows(folder / "seed1" / "rgb_default.csv")[0]
    assert [name for name in row if name.endswith("_frames")] == [
        f"{p}_frames" for p in asked.phases
    ]
    assert all(row[f"{phase}_{need}"] for phase, need in asked.needed.items())
    assert f"of {asked.fact}, the share" in (folder / "phases.md").read_text()
    before = _files(tmp_path)
    assert _run(tmp_path, "cams=rgb_default", "seeds=2") == 2
    assert re.search("another episode, .*task; choose", capsys.readouterr().err)
    assert _files(tmp_path) == before


def test_a_probe_is_of_one_renderer_and_of_any_number_of_threads(probed, capsys):
    words = ("cams=rgb_default", "seeds=1")
    before = _files(probed)
    assert _run(probed, *words, "engine.renderer=tracer") == 2
    assert "holds a probe with another engine.renderer; choose" in capsys.readouterr().err
    assert _files(probed) == before
    assert _run(probed, *words, "engine.threads=2") == 0


def test_a_stopped_probe_goes_on_to_the_same_bits(whole, tmp_path, monkeypatch, capsys):
    words = ("cams=rgb_default,seg_side", "seeds=1", "engine.threads=1")
    saves = []
    save = Folder.save

    def stop(self: Folder, seed: int, name: str, *found: np.ndarray) -> None:
        if len(saves) == 2:
            raise KeyboardInterrupt
        saves.append(name)
        save(self, seed, name, *found)

    with monkeypatch.context() as patched:
        patched.setattr(Folder, "save", stop)
        assert _run(tmp_path, *words) == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert len(list((tmp_path / "probe").rglob("seed*/*.csv"))) == 2
    assert _run(tmp_path, *words) == 0
    ours, theirs = _files(tmp_path / "probe"), _files(whole / "probe")
    assert ours.keys() == theirs.keys()
    differ = [name for name in ours if ours[name] != theirs[name]]
    assert set(differ) <= {"manifest.json", "config.yaml"}


def test_camera_sets_are_added_and_the_time_of_all_calls_is_counted(probed, monkeypatch, capsys):
    folder = probed / "probe"
    path = folder / "manifest.json"
    path.write_text(json.dumps({"wall_time": 5000.0, "memory_gb": 900.0}))
    before = (folder / "seed0" / "rgb_default.csv").stat().st_mtime_ns
    assert _run(probed, "cams=dep_side", "seeds=1") == 0
    assert (folder / "seed0" / "rgb_default.csv").stat().st_mtime_ns == before
    assert {"rgb_default", "dep_side"} <= {row["cameras"] for row in _rows(folder / "ranking.csv")}
    done = path.read_bytes()
    manifest = json.loads(done)
    assert 5000 < manifest["wall_time"] < 6000
    assert manifest["memory_gb"] == 900
    assert manifest["command"][-2:] == ["cams=dep_side", "seeds=1"]
    with monkeypatch.context() as patched:
        patched.setattr(measuring, "collect", None)
        assert _run(probed, "cams=dep_side", "seeds=1") == 0, "all there: nothing to collect"
    assert path.read_bytes() == done, "it took nothing"
    assert _run(probed, "cams=dep_side", "seeds=1", "overwrite=true") == 0
    assert json.loads(path.read_text())["wall_time"] < 1000
    path.write_text('{"wall')
    assert _run(probed, "cams=dep_side", "seeds=1") == 2
    assert f"{path} is no JSON, or cut off; put it back" in capsys.readouterr().err


def test_a_folder_of_something_else_or_other_settings_is_left_alone(probed, capsys):
    before = _files(probed)
    assert _run(probed, "cams=rgb_default", "seeds=1", "task=wide") == 2
    assert "another task; choose another study=" in capsys.readouterr().err
    assert _files(probed) == before
    (probed / "notes").mkdir()
    (probed / "notes" / "mine.txt").write_text("mine")
    for words in ([], ["overwrite=true"]):
        assert _run(probed, "study=notes", *words) == 2
        assert "holds files but no probe" in capsys.readouterr().err
    assert (probed / "notes" / "mine.txt").read_text() == "mine"


def test_bad_settings_stop_before_anything_is_written(tmp_path, capsys):
    for words, said in (
        (["seeds=0"], "seeds: 0 must be at least 1"),
        (["seeds=two"], "seeds"),
        (["fit.updates=0"], "fit.updates"),
        (["episodes.train=1"], "episodes.train"),
        (["image_size=3"], "image_size"),
        (["overwrite=maybe"], "overwrite"),
        (["cams=rgb_top"], "choose from default, front, side"),
        (["grid.like=top", "--grid", "views"], "grid.like: 'top' is unknown"),
        (["grid.azimuths=[0]", "--grid", "views"], "grid.azimuths"),
        (["grid.elevations=[95,99]", "--grid", "views"], "elevation: 95"),
        (["episodes.more=1"], "more"),
    ):
        assert cli.main(["probe", f"results={tmp_path}", *words]) == 2
        assert said in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


def test_a_torn_file_is_named(probed, capsys):
    torn = probed / "probe" / "seed0" / "rgb_default.csv"
    torn.write_bytes(torn.read_bytes()[:500])
    assert _run(probed, "cams=rgb_default", "seeds=1") == 2
    assert str(torn) in capsys.readouterr().err


def test_a_grid_of_views_is_probed_and_mapped(tmp_path):
    grid = ["grid.azimuths=[-30,0,30]", "grid.elevations=[20,50]", "seeds=1"]
    assert _run(tmp_path, *grid, "--grid", "views") == 0
    folder = tmp_path / "probe" / "views_rgb"
    assert (folder / "map.png").exists()
    names = {file.stem for file in (folder / "seed0").iterdir()} - {CONSTANT, TRUTH}
    assert names == {f"rgb_az{a}-el{e}" for a in (-30, 0, 30) for e in (20, 50)}


def test_a_grid_view_like_a_named_one_is_that_view(settings):
    own = settings.views["side"]
    grid = Grid("rgb", "side", own.fovy, (0.0, own.azimuth), (own.elevation, 60.0))
    assert grid.views(settings.views)[f"az{own.azimuth:g}-el{own.elevation:g}"] == own


def test_the_map_puts_each_score_where_its_camera_stands(settings):
    grid = Grid("rgb", "default", 20.0, (-30.0, 0.0, 60.0), (10.0, 40.0))
    scores = {f"rgb_az{a:g}-el{e:g}": a + e for a in grid.azimuths for e in grid.elevations}
    results = SimpleNamespace(score=lambda name: SimpleNamespace(value=scores[name]))
    view = settings.views["default"]
    figure = view_map(results, grid, {"default": view})
    said = {t.get_position(): t.get_text() for t in figure.axes[0].texts}
    assert said[60.0, 10.0] == "70.00"
    assert said[-30.0, 40.0] == "10.00"
    edges = figure.axes[0].collections[0].get_coordinates()
    assert edges[0, :, 0].tolist() == [-45.0, -15.0, 30.0, 90.0]


def test_tables_hold_the_papers_lists_against_the_probe(tmp_path):
    """A probe that finds the paper's own returns agrees with them wholly."""
    from needlehoop.study.data import paper

    folder = Folder(tmp_path / "probe", ASKED, {"fit": 1}, False)
    errors = {CONSTANT: 10.0, TRUTH: 0.1}
    errors |= {name: 10.0 - value for name, value in paper.measured().items()}
    for name, value in errors.items():
        folder.save(0, name, _errors([value] * 3, 12, 0.0, 0), np.ones((12, 3), dtype=int))
    found = folder.results(1)
    tables = {table.name: table for table in all_tables(found)}
    rows = [
        row
        for row in tables["agreement"].rows.to_numpy().tolist()
        if row[1] == "the paper's measured"
    ]
    assert [row[2] for row in rows] == ["5", "5", "6", "14"]
    assert {row[3] for row in rows[:3]} == {"1.00"}
    assert all(row[7:] == ["yes", "yes", "0.00"] for row in rows)
    vlm = [
        row for row in tables["agreement"].rows.to_numpy().tolist() if row[1] == "the paper's VLM"
    ]
    # As the paper's VLM agrees with the paper's own measurements.
    assert [row[3] for row in vlm] == ["0.60", "0.60", "0.60"]
    first = tables["ranking"].rows.to_numpy().tolist()[0]
    assert first[1] == "dep_front+seg_side"
    assert tables["ranking"].rows.to_numpy().tolist()[-1][1] == "constant"
    axes = ranking_figure(found).axes
    assert axes[0].get_yticklabels()[0].get_text() == "dep_front+seg_side"
    found.asked = replace(ASKED, task="reach")
    elsewhere = found
    assert "agreement" not in {table.name for table in all_tables(elsewhere)}, "another task's"
    assert len(tables["phases"].rows) == 16 * len(ASKED.phases) * len(ASKED.names)


def test_probes_share_no_episodes_with_each_other_or_with_training(settings, tmp_path):
    plan = _plan(settings, tmp_path, ["rgb_default"], 1)
    seeds = [seed for k in range(5) for seed in plan.episode_seeds(k)]
    job = composing.compose([], "job")
    evaluation = job["evaluation"]["seed"]
    assert len({*seeds, job["seed"], evaluation, evaluation + 1}) == len(seeds) + 3


def test_todays_settings_are_those_of_the_shipped_probe(tmp_path, monkeypatch, capsys):
    shipped = Path(__file__).parents[2] / "results" / "probe"
    shutil.copytree(shipped, tmp_path / "probe")

    def stop(*_: object) -> None:
        raise ValueError("its settings were accepted")

    monkeypatch.setattr("needlehoop.probe.folder.Folder.results", stop)
    assert cli.main(["probe", f"results={tmp_path}"]) == 2
    assert "its settings were accepted" in capsys.readouterr().err


@pytest.mark.full
def test_showing_the_shipped_probe_changes_none_of_its_files(tmp_path, monkeypatch):
    shipped = Path(__file__).parents[2] / "results" / "probe"
    copy = shutil.copytree(shipped, tmp_path / "results" / "probe")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["probe"]) == 0
    kept = [path for path in shipped.rglob("*.*") if path.suffix != ".svg"]
    shown = {path: (copy / path.relative_to(shipped)).read_bytes() for path in kept}
    assert shown == {path: path.read_bytes() for path in kept}


def test_what_is_not_measured_is_not_measured_unasked(tmp_path, capsys):
    assert cli.main(["probe", f"results={tmp_path}", "cams=rgb_default", "seeds=1"]) == 2
    said = capsys.readouterr().err
    assert f"compute: {tmp_path}/probe lacks 2 measurements" in said
    assert "cams=rgb_default seeds=1 compute=true` makes them, in about a minute" in said
    assert not list(tmp_path.iterdir())
