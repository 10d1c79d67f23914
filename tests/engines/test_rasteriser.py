"""The rasteriser, with the ray tracer as its oracle."""

from collections import Counter
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from needlehoop.engines.contract import FIELDS, Channels
from needlehoop.engines.rasteriser.renderer import CpuRasteriser, ParallelRasteriser
from needlehoop.engines.rasteriser.solids import surface_of
from needlehoop.engines.tracer import Tracer
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller
from needlehoop.envs.settings import compose_settings
from needlehoop.tasks.needle_hoop.expert import Expert

ALL = Channels(True, True, True)
VIEWS = ("default", "front", "side")
STATES = ("start", "grasp", "goal", "random")
ENVS = 8


@pytest.fixture(scope="module")
def scene():
    """The compiled scene, and the fields of MjData by state."""
    settings = compose_settings([f"num_envs={ENVS}", "cams=[rgb_front,rgb_wrist]", "seed=11"])
    simulation = build(settings)
    engine = simulation.engine
    fields = {}

    def keep(state):
        datas = [engine.data(env) for env in range(ENVS)]
        fields[state] = {
            name: torch.from_numpy(np.stack([getattr(data, name) for data in datas]))
            for name in FIELDS
        }

    act, moment = Expert(settings.task, settings.episode), simulation.reset()
    keep("start")
    while not bool(moment.signals.grasped.all()):
        moment = simulation.step(act(moment.signals))
    keep("grasp")
    while not bool(moment.signals.threaded.all()):
        moment = simulation.step(act(moment.signals))
    keep("goal")
    act, moment = controller("random", replace(settings, seed=5)), simulation.reset()
    for _ in range(25):
        moment = simulation.step(act(moment.signals))
    keep("random")
    return engine.model, fields


@pytest.fixture(scope="module")
def both(scene):
    """Renderers of all channels of all views: rasteriser and tracer."""
    views = dict.fromkeys((*VIEWS, "wrist"), ALL)
    return CpuRasteriser(scene[0], ENVS, views, 64, 1), Tracer(scene[0], ENVS, views, 64)


def agree(drawn, traced, geom=0.998, near=0.99, colour=0.98, depth=1e-3):
    """Assert such shares of pixels with the same geom, a depth within 1 mm, a colour within 3.

    The colour's is among inner pixels: those whose eight neighbours show the same geom.
    """
    alike = ((drawn.bgra.int() - traced.bgra.int()).abs() <= 3).all(-1)
    padded = torch.nn.functional.pad(traced.geom.float()[:, None], (1, 1, 1, 1), mode="replicate")
    around = padded.unfold(2, 3, 1).unfold(3, 3, 1)[:, 0]
    inner = (around == traced.geom[..., None, None]).all(-1).all(-1)
    assert (drawn.geom == traced.geom).double().mean() >= geom
    assert ((drawn.depth - traced.depth).abs() < depth).double().mean() >= near
    assert alike[inner].double().mean() >= colour


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("view", [*VIEWS, "wrist"])
def test_every_view_shows_what_the_tracer_shows(scene, both, view, state):
    drawn, traced = (renderer.render(scene[1][state])[view] for renderer in both)
    agree(drawn, traced)


def test_colours_agree_on_every_material(scene, both):
    # Most pixels show the table: what stands on it must agree by itself.
    model, fields = scene
    wrong, seen = Counter(), Counter()
    for state in STATES:
        frames = [renderer.render(fields[state]) for renderer in both]
        for view in VIEWS:
            drawn, traced = frames[0][view], frames[1][view]
            alike = ((drawn.bgra.int() - traced.bgra.int()).abs() <= 3).all(-1)
            same = drawn.geom == traced.geom
            for geom in traced.geom.unique().tolist():
                here = same & (traced.geom == geom)
                material = model.mat(int(model.geom_matid[geom])).name
                wrong[material] += int((here & ~alike).sum())
                seen[material] += int(here.sum())
    assert {"needle", "hoop", "stand", "steel", "jaw", "shaft", "table"} <= set(seen)
    for material, count in seen.items():
        assert wrong[material] <= 0.05 * count, (material, wrong[material], count)


@pytest.mark.parametrize(
    "channels", [(True, False, False), (False, True, False), (False, False, True)]
)
def test_a_channel_is_the_same_alone_and_the_others_are_not_made(scene, both, channels):
    model, fields = scene
    views = {"side": Channels(False, True, True), "front": Channels(*channels)}
    alone = CpuRasteriser(model, ENVS, views, 64, 1).render(fields["grasp"])["front"]
    whole = both[0].render(fields["grasp"])["front"]
    for needed, channel, of_all in zip(channels, alone, whole, strict=True):
        assert torch.equal(channel, of_all) if needed else channel is None


def test_threads_and_subsets_change_no_bit(scene):
    model, fields = scene
    views = {"front": ALL, "side": Channels(False, True, False)}
    whole = CpuRasteriser(model, ENVS, views, 64, 1).render(fields["goal"])
    for threads in (2, 3):
        renderer = CpuRasteriser(model, ENVS, views, 64, threads)
        for ids in (None, torch.tensor([5]), torch.tensor([6, 0, 3]), torch.arange(ENVS)):
            frames = renderer.render(fields["goal"], ids)
            for view, frame in frames.items():
                for channel, of_all in zip(frame, whole[view], strict=True):
                    if channel is not None:
                        assert torch.equal(channel, of_all if ids is None else of_all[ids])


@pytest.mark.parametrize("kind", ["one after the other", "at once"])
@pytest.mark.parametrize("width", [48, 64, 100])
def test_an_image_that_is_not_square_shows_the_middle_of_a_wider_one(scene, kind, width):
    def drawn(size):
        views = {"front": ALL, "wrist": ALL}
        if kind == "at once":
            made = ParallelRasteriser(scene[0], ENVS, views, size, torch.device("cpu"))
        else:
            made = CpuRasteriser(scene[0], ENVS, views, size, 1)
        return made.render(scene[1]["goal"])

    whole, part = drawn((120, 64)), drawn((width, 64) if width != 64 else 64)
    left = (120 - width) // 2
    for view, frame in part.items():
        for name, channel, wide in zip(frame._fields, frame, whole[view], strict=True):
            middle = wide[:, :, left : left + width]
            assert channel.shape == middle.shape == (ENVS, 64, width, *channel.shape[3:])
            if name == "depth":
                assert torch.allclose(channel, middle, rtol=0.0, atol=1e-6)
            else:
                assert torch.equal(channel, middle), (view, name)


WORLD = """
<mujoco>
  <visual><headlight ambient=".3 .3 .3" diffuse=".4 .4 .4"/></visual>
  <asset>
    <material name="red" rgba=".9 .2 .1 1"/>
    <material name="glow" rgba=".2 .5 .3 1" emission=".2"/>
    <mesh name="wedge" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3  .1 .1 0"
          face="0 2 1  0 1 3  0 3 2  1 2 3  0 1 1"/>
  </asset>
  <worldbody>
    <light type="directional" dir="1 2 -3" diffuse=".5 .4 .3" ambient=".1 .1 .1"/>
    <light type="directional" dir="-1 1 -1" diffuse=".2 .2 .4"/>
    {bodies}
    <camera name="eye" pos="{position}" xyaxes="{axes}" fovy="{fovy}"/>
  </worldbody>
</mujoco>
"""

BODIES = """
    <geom type="plane" size="0 0 1" material="red" pos="0 0 -.4"/>
    <geom type="box" size=".1 .2 .3" pos="-.5 1.5 0" euler="20 30 40" material="glow"/>
    <geom type="cylinder" size=".15 .3" pos=".4 1.6 .2" euler="50 10 0" rgba=".1 .6 .9 1"/>
    <geom type="capsule" size=".12 .2" pos="0 1.2 -.2" euler="0 70 20" material="red"/>
    <geom type="mesh" mesh="wedge" pos=".1 1 .3" material="glow"/>
"""


def look(bodies, position="0 0 0", axes="1 0 0 0 0 1", fovy=60, size=96):
    """What both renderers see of a world from a camera that looks along y by default."""
    text = WORLD.format(bodies=bodies, position=position, axes=axes, fovy=fovy)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    fields = {name: torch.tensor(getattr(data, name)[None]) for name in FIELDS}
    renderers = CpuRasteriser(model, 1, {"eye": ALL}, size, 1), Tracer(model, 1, {"eye": ALL}, size)
    return [renderer.render(fields)["eye"] for renderer in renderers]


@pytest.mark.parametrize(
    ("position", "axes", "fovy", "size"),
    [("0 0 0", "1 0 0 0 0 1", 35, (96, 48)), (".2 .4 .5", "1 .2 0 0 .6 .8", 120, 96)],
)
def test_any_camera_sees_every_type_of_geom_under_every_light(position, axes, fovy, size):
    drawn, traced = look(BODIES, position, axes, fovy, size)
    assert len(traced.geom.unique()) >= 2
    # Dozens of times larger than what the robot handles, with polygons of at most 48 corners.
    agree(drawn, traced, geom=0.99, depth=3e-3)


@pytest.mark.parametrize(
    "body",
    [
        '<geom type="cylinder" size="1.5 .1" pos="0 .2 .25" euler="10 0 0"/>',
        '<geom type="mesh" mesh="wedge" pos="-.1 -.1 -.15"/>',
        # It stands in the camera's plane.
        '<geom type="box" size=".3 .5 .5" pos="-.6 .5 0"/>',
    ],
)
def test_what_reaches_behind_the_camera_is_drawn_in_front_of_it(body):
    drawn, traced = look(body, fovy=90)
    assert (traced.geom == 0).float().mean() > 0.03
    agree(drawn, traced, geom=0.995, near=0.98, colour=0.0)


@pytest.mark.parametrize(
    "body",
    [
        '<geom type="box" size=".5 .5 .5" pos="0 -.51 0"/>',
        '<geom type="box" size=".5 .5 .5" pos="5 1 0"/>',
        # A plane is not seen from below.
        '<geom type="plane" size="0 0 1" pos="0 0 .3"/>',
    ],
)
def test_what_is_not_before_the_camera_is_not_drawn(body):
    drawn, traced = look(body, fovy=40)
    assert torch.equal(drawn.geom, traced.geom)
    assert (drawn.geom == -1).all()
    assert (drawn.depth == 0).all()
    assert (drawn.bgra == torch.tensor([0, 0, 0, 255], dtype=torch.uint8)).all()


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ('<geom type="ellipsoid" size=".1 .2 .3"/>', "mjGEOM_ELLIPSOID.*mjGEOM_BOX"),
        ('<geom type="plane" size="1 1 1"/>', "plane"),
        ('<geom type="box" size="1 1 1" rgba="1 1 1 .5"/>', "transparent"),
        ('<light type="spot"/>', "directional"),
    ],
)
def test_what_cannot_be_drawn_is_refused(bodies, message):
    with pytest.raises(ValueError, match=message):
        look(bodies)


def test_surfaces_are_closed_and_face_outwards(model):
    for geom in range(model.ngeom):
        if model.geom_group[geom] > 1 or model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        surface = surface_of(model, geom)
        names = [tuple(np.round(vertex, 9) + 0.0) for vertex in surface.vertices]
        edges = Counter(
            (names[face[i]], names[face[i - 2]]) for face in surface.faces for i in range(3)
        )
        assert set(edges.values()) == {1}, geom
        assert set(edges) == {(b, a) for a, b in edges}, geom
        lengths = np.linalg.norm(surface.normals, axis=-1)
        assert np.allclose(lengths, 1.0, atol=1e-5), geom
        assert (np.einsum("tcx,tx->tc", surface.normals, surface.planes[:, :3]) > 0.6).all(), geom


def test_round_geoms_keep_to_a_tenth_of_a_millimetre(model):
    for geom in range(model.ngeom):
        if model.geom_group[geom] > 1 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_CYLINDER:
            continue
        radius, surface = model.geom_size[geom, 0], surface_of(model, geom)
        # Corners are farthest out, the middles of their chords farthest in.
        corners = surface.vertices[surface.faces][..., :2]
        chords = (corners + np.roll(corners, 1, 1)) / 2
        side = np.abs(surface.planes[:, 2]) < 0.5
        out = np.linalg.norm(corners[side], axis=-1).max()
        across = np.linalg.norm(chords[side], axis=-1).min()
        assert radius - 1.5e-4 < across < radius < out < radius + 1e-4, geom
