"""The Warp engine on Warp's CPU device: it does what the CPU engine does, within float32."""

from __future__ import annotations

import pytest
import torch
import warp as wp
from tiny_runs import composed
from virtual_cuda import CUDA, put, virtual_cuda

from needlehoop.disturbances import sensors
from needlehoop.engines import warp_device
from needlehoop.engines.contract import FIELDS, Frame
from needlehoop.engines.rasteriser import parallel
from needlehoop.engines.rasteriser.renderer import ParallelRasteriser
from needlehoop.engines.warp_engine import WarpEngine
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, outcome_of
from needlehoop.envs.images import channels_of
from needlehoop.envs.settings import compose_settings
from needlehoop.envs.simulation import Simulation
from needlehoop.learning.job import checked_job
from needlehoop.learning.learner import Learner

WARP = ["engine=warp", "engine.device=cpu", "engine.threads=1"]
TASKS = ("needle_hoop", "reach", "peg_transfer", "handover")
SEVERE = "disturb=severe"


def built(*words: str, envs: int = 3) -> Simulation:
    return build(compose_settings([*WARP, f"num_envs={envs}", *words]))


def of_task(name: str) -> list[str]:
    return [] if name == "needle_hoop" else [f"task={name}"]


def teacher(simulation: Simulation):
    settings = simulation.settings
    return controller(settings.definition.teacher, settings)


@pytest.mark.parametrize(
    "task", [*TASKS[:2], *(pytest.param(one, marks=pytest.mark.full) for one in TASKS[2:])]
)
def test_the_teacher_succeeds(task):
    simulation = built(*of_task(task), envs=1)
    assert outcome_of(simulation, teacher(simulation)).success.all()


@pytest.mark.full
@pytest.mark.parametrize("grasp", ["weld", "friction"])
@pytest.mark.parametrize("task", TASKS)
def test_the_expert_succeeds_in_all_of_many_episodes(task, grasp):
    words = [] if task == "reach" else [f"episode.grasp={grasp}"]
    simulation = built(*of_task(task), *words, envs=50)
    expert = controller("expert", simulation.settings)
    assert outcome_of(simulation, expert).success.all()


def test_it_stays_near_the_cpu_engine_and_shows_the_same():
    cams = "cams=[rgb_front,dep_side,seg_wrist]"
    warp, cpu = built(cams), build(compose_settings([cams, "num_envs=3", "engine.threads=1"]))
    act, moment, expected = teacher(warp), warp.reset(), cpu.reset()
    for step in range(15):
        if step in (0, 10):
            apart = (moment.signals.needle_tip - expected.signals.needle_tip).norm(dim=-1)
            assert float(apart.max()) < 2e-5
            images, same = warp.images(), cpu.images()
            for name, image in images.items():
                assert float((image != same[name]).float().mean()) < 1e-3, name
        action = act(expected.signals)
        moment, expected = warp.step(action), cpu.step(action)


def test_the_same_seed_gives_the_same_bits_and_a_reset_touches_no_others():
    first, second = built(SEVERE), built(SEVERE)
    act, moments = teacher(first), [one.reset() for one in (first, second)]
    mask = torch.tensor([False, True, False])
    for step in range(6):
        if step == 3:
            kept = first.snapshot()
            first.begin(mask)
            # What is derived of the others, too.
            for name in ("qpos", "sensordata", "geom_xpos"):
                assert torch.equal(first.engine.read(name)[::2], second.engine.read(name)[::2])
            first.restore(kept)
        action = act(moments[0].signals)
        moments = [one.step(action) for one in (first, second)]
        assert torch.equal(first.engine.sensordata(), second.engine.sensordata())


def test_a_scene_that_breaks_down_begins_anew_and_the_others_go_on():
    whole, broken = built(), built()
    action = torch.full((3, 5), 0.3)
    for simulation in (whole, broken):
        simulation.reset()
        simulation.step(action)
    broken.engine.read("qvel")[1, 2] = float("nan")
    moment, other = broken.step(action), whole.step(action)
    assert moment.facts["diverged"].tolist() == moment.truncated.tolist() == [False, True, False]
    assert all(bool(torch.isfinite(one.double()).all()) for one in moment.signals.values())
    assert torch.equal(moment.signals.joints[::2], other.signals.joints[::2])
    assert not broken.reset(moment.truncated).facts["diverged"].any()


def held_for(seconds: float, grasp: str) -> float:
    """How far a needle that is held moves in the jaws, mm."""
    words = ["episode.end_on_success=false", "episode.max_steps=2000", f"episode.grasp={grasp}"]
    simulation = built(*words, envs=1)
    act, moment = teacher(simulation), simulation.reset()
    while not bool(moment.signals.lifted.all()):
        moment = simulation.step(act(moment.signals))
    still = torch.zeros(1, simulation.episode.action_size)

    def place() -> torch.Tensor:
        return moment.signals.pickup_point - moment.signals.tool_midpoint

    for _ in range(25):
        moment = simulation.step(still)
    before = place()
    for _ in range(round(seconds / simulation.settings.period)):
        moment = simulation.step(still)
    return 1e3 * float((place() - before).norm())


@pytest.mark.full
@pytest.mark.parametrize("grasp", ["weld", "friction"])
def test_a_needle_that_is_held_stays_for_a_minute(grasp):
    assert held_for(60.0, grasp) < 0.1


def test_too_few_contacts_are_an_error_that_says_so():
    simulation = built("engine.contacts=1", envs=1)
    act, moment = teacher(simulation), simulation.reset()
    for _ in range(12):
        moment = simulation.step(act(moment.signals))
    with pytest.raises(RuntimeError, match=r"engine.contacts: 1 are too few in environments \["):
        simulation.reset()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["engine.device=cuda"], r"engine.device: 'cuda' is unknown; choose from cpu"),
        (["engine.renderer=tracer"], r"engine.renderer: 'tracer'; engine=warp draws by rasteriser"),
        (["quality=2", "cams=[rgb_front]"], r"quality: 2; engine=warp draws with quality=1 alone"),
        (["engine.kind=cpu", "engine.device=cuda"], r"engine.device: 'cuda' needs engine=warp"),
    ],
)
def test_what_it_cannot_do_is_refused(words, message):
    with pytest.raises(ValueError, match=message):
        built(*words)


def flown(disturb: str) -> tuple[Simulation, dict[str, torch.Tensor]]:
    """A CPU simulation in the middle of episodes, and what it draws."""
    words = ["cams=[rgb_front,dep_side,seg_wrist,dep_wrist]", disturb, "num_envs=8"]
    simulation = build(compose_settings([*words, "engine.threads=1"]))
    act, moment = teacher(simulation), simulation.reset(stagger=True)
    for _ in range(9):
        moment = simulation.step(act(moment.signals))
    fields = {name: simulation.engine.read(name) for name in FIELDS}
    if simulation.disturbance is not None:
        fields = dict(simulation.disturbance.optics(fields))
    return simulation, fields


# The table's pattern has cells, at whose edges rounding decides.
@pytest.mark.parametrize(("disturb", "share"), [("disturb=none", 0.0), (SEVERE, 1e-4)])
def test_images_drawn_at_once_are_those_drawn_one_after_the_other(disturb, share, monkeypatch):
    monkeypatch.setattr("needlehoop.engines.rasteriser.renderer._AT_ONCE", 9)
    simulation, fields = flown(disturb)
    settings = simulation.settings
    views, size = channels_of(settings), settings.image_size
    model, renderer = simulation.engine.model, simulation.engine._renderer
    at_once = ParallelRasteriser(model, settings.num_envs, views, size, torch.device("cpu"))
    for ids in (None, torch.tensor([6, 1])):
        expected = renderer.render(fields, ids)
        for view, frame in at_once.render(fields, ids).items():
            for name, channel, other in zip(Frame._fields, frame, expected[view], strict=True):
                assert (channel is None) == (other is None)
                if channel is not None and name == "depth":
                    assert torch.allclose(channel, other, rtol=0.0, atol=1e-6)
                elif channel is not None:
                    assert float((channel != other).float().mean()) <= share, (view, name)


def test_pictures_spoilt_at_once_are_those_spoilt_one_after_the_other(monkeypatch):
    simulation, fields = flown(SEVERE)
    simulation.engine._renderer.render(fields)
    one_by_one = simulation.images()
    sensors = simulation.disturbance._sensors
    room, n = sensors._room, simulation.num_envs
    monkeypatch.setattr(sensors, "_stride", room)
    monkeypatch.setattr(sensors, "_room", n * room)
    for name, image in simulation.images().items():
        assert torch.equal(image, one_by_one[name])


def test_nothing_mixes_the_devices(monkeypatch):
    """Warp runs on the CPU; torch is told that what it gets from there is on a GPU."""
    to_torch = wp.to_torch

    def on_cpu(*_):
        return wp.ScopedDevice("cpu")

    monkeypatch.setattr(warp_device, "on", on_cpu)
    for where in (wp, wp._src.torch):
        monkeypatch.setattr(where, "device_from_torch", lambda device: wp.get_device("cpu"))
    monkeypatch.setattr(wp, "to_torch", lambda array: put(to_torch(array), True))
    monkeypatch.setattr(WarpEngine, "_run", lambda self, what: self._launch(what))
    small = [
        *("engine=warp", "engine.threads=1", "cams=[dep_front,seg_side]", "image_size=16"),
        *("num_envs=2", "episode.max_steps=3", "obs.proprio=true", SEVERE, "disturb.ramp=0"),
        *("device=cuda", "precision=fp32", "algo.horizon=4", "algo.network.hidden=8"),
        *("encoder=resnet_s4d", "steps=16"),
    ]
    for method in (["algo.epochs=1", "algo.minibatch=4"], ["algo=dagger", "algo.minibatches=2"]):
        with virtual_cuda():
            learner = Learner(checked_job(composed(*small, *method)))
            for buffer, _ in learner:
                assert buffer.device == CUDA
                assert buffer["pixels", "dep_front"].device == CUDA


@pytest.mark.parametrize("arch", [pytest.param(89, marks=pytest.mark.full), 90])
def test_its_own_kernels_compile_for_gpus(arch, tmp_path):
    for kernel in (parallel.shade, sensors.spoil):
        wp.compile_aot_module(kernel.module, arch=arch, module_dir=tmp_path, use_ptx=False)
    assert len([*tmp_path.rglob(f"*sm{arch}.cubin")]) == 2


@pytest.mark.full
@pytest.mark.parametrize("arch", [89, 90])
def test_all_kernels_compile_for_gpus(arch, tmp_path):
    words = ["cams=[rgb_front,seg_wrist]", SEVERE, "episode.grasp=friction"]
    simulation = built(*words, envs=1)
    moment = simulation.reset()
    simulation.step(teacher(simulation)(moment.signals))
    simulation.images()
    used = [one for one in wp._src.context.user_modules.values() if one.execs]
    for module in used:
        wp.compile_aot_module(module, arch=arch, module_dir=tmp_path, use_ptx=True)
    assert len([*tmp_path.rglob(f"*sm{arch}.ptx")]) >= len(used) > 50
