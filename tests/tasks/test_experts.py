"""Each task can be done, by scripts that see signals; not by chance; and it can be faked."""

import pytest
import torch
from strength import ALL
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, outcome_of, run_trials
from needlehoop.envs.settings import compose_settings
from needlehoop.scene.signals import Signals
from needlehoop.tasks.layout import GRASPS

EPISODES = 200 if ALL else 24


def flown(task: str, grasp: str, kind: str, rate: float, least: float, full: bool = False):
    words = [f"task={task}", *([f"episode.grasp={grasp}"] if grasp else [])]
    marks = [pytest.mark.full] if full else []
    return pytest.param(words, kind, rate, least, id=f"{task} {grasp} {kind}", marks=marks)


@pytest.mark.parametrize(
    ("words", "kind", "rate", "least"),
    [
        flown("standard", "weld", "expert", 0.98, 8.0),
        flown("standard", "friction", "expert", 0.90, 8.0),
        # The smooth one is still on its way when the episode ends.
        flown("standard", "weld", "smooth", 0.98, 7.4),
        flown("wide", "friction", "smooth", 0.98, 7.4),
        flown("peg_transfer/standard", "weld", "expert", 0.98, 8.0),
        flown("peg_transfer/wide", "friction", "smooth", 0.90, 8.0),
        *(
            flown(f"peg_transfer/{layout}", grasp, kind, rate, 8.0, full=True)
            for layout in ("near", "wide")
            for grasp, rate in (("weld", 0.98), ("friction", 0.90))
            for kind in ("expert", "smooth")
        ),
        flown("reach/wide", "", "expert", 0.99, 7.9),
        flown("reach/wide", "", "smooth", 0.99, 7.9),
        flown("handover/standard", "weld", "expert", 0.98, 8.4),
        flown("handover/wide", "friction", "smooth", 0.85, 8.4),
        *(
            flown(f"handover/{layout}", grasp, kind, rate, 8.4, full=True)
            for layout in ("standard", "wide")
            for grasp, rate in (("weld", 0.98), ("friction", 0.85))
            for kind in ("expert", "smooth")
        ),
    ],
)
def test_the_experts_succeed(words, kind, rate, least):
    outcome = run_trials(compose_settings(words), kind, EPISODES)
    assert outcome.success.double().mean() >= rate
    done = outcome.potential[outcome.success]
    assert least <= done.min() <= done.max() <= 12.2


@pytest.mark.parametrize(
    ("words", "column", "most"),
    [
        # The geometry allows it: the tip comes within the goal's radius before the opening.
        ([], "touched", 12.0),
        (["task=peg_transfer"], "over", 7.0),
        (["task=peg_transfer", "episode.grasp=friction"], "over", 7.0),
        (["task=handover"], "fetched", 2.0),
        (["task=handover", "episode.grasp=friction"], "fetched", 2.0),
    ],
)
def test_a_cheat_is_told_apart(words, column, most):
    outcome = run_trials(compose_settings(words), "cheat", 12)
    assert outcome.facts[column].double().mean() >= 0.9
    assert torch.equal(outcome.facts["cheat"], outcome.facts[column])
    assert not outcome.success.any()
    assert outcome.potential.max() < most


@pytest.mark.parametrize(
    ("words", "most"), [([], 4.0), (["task=peg_transfer"], 7.0), (["task=handover"], 2.0)]
)
def test_chance_does_not_do_it(words, most):
    outcome = run_trials(compose_settings(words), "random", 16)
    assert not outcome.success.any()
    assert outcome.potential.max() < most


@pytest.mark.parametrize("grasp", GRASPS)
def test_trials_do_not_depend_on_how_many_there_are(grasp):
    settings = compose_settings([f"episode.grasp={grasp}"])
    few, many = (run_trials(settings, "expert", n) for n in (2, 5))
    assert torch.equal(few.potential, many.potential[:2])


@pytest.mark.parametrize(
    ("task", "places", "away", "sigma", "kind", "least", "most"),
    [
        ("standard", ("pickup_point", "needle_tip"), 0.004, 0.0035, "smooth", 0.7, 1.0),
        ("standard", ("pickup_point", "needle_tip"), 0.004, 0.0035, "expert", 0.0, 0.2),
        ("peg_transfer", ("pickup_point", "block_position"), 0.003, 0.002, "smooth", 0.8, 1.0),
        ("reach", ("target",), 0.0015, 0.0025, "smooth", 0.95, 1.0),
        ("handover", ("pickup_1", "pickup_2", "needle_middle"), 0.003, 0.0025, "smooth", 0.8, 1.0),
    ],
)
def test_only_the_smooth_expert_can_do_with_what_images_give(
    task, places, away, sigma, kind, least, most
):
    # A learner does what the expert would do on average over what may be there, and is wrong
    # about it in the same way throughout an episode.
    settings = compose_settings([f"num_envs={40}", f"task={task}"])
    simulation = build(settings)
    generator = torch.Generator().manual_seed(0)
    script = controller(kind, settings)
    bias = torch.randn(40, 3, generator=generator, dtype=torch.float64)
    bias *= away / bias.norm(dim=-1, keepdim=True)

    def noise(like: Tensor) -> Tensor:
        return sigma * torch.randn(like.shape, generator=generator, dtype=like.dtype)

    def learner(signals: Signals) -> Tensor:
        guesses = torch.cat([signals] * 16)
        for name in places:
            place = getattr(guesses, name)
            setattr(guesses, name, place + bias.repeat(16, 1) + noise(place))
        if task != "handover":
            # Places are off by so many mm, and angles of the jaws as much.
            turned = 70.0 * noise(guesses.jaw)
            guesses.jaw, guesses.jaw_command = guesses.jaw + turned, guesses.jaw_command + turned
        if task == "standard":
            # Whether almost shut jaws hold the needle is a guess.
            near = (signals.pickup_point - signals.tool_midpoint).norm(dim=-1) < 0.006
            unsure = (near & (signals.jaw < 0.45)).repeat(16)
            unsure &= torch.rand(unsure.shape, generator=generator) < 0.4
            guesses.grasped = guesses.grasped ^ unsure
        return script(guesses).view(16, 40, -1).mean(0)

    assert least <= outcome_of(simulation, learner).success.double().mean() <= most


def test_what_no_controller_can_do_is_refused_by_name():
    with pytest.raises(ValueError, match=r"controller.*expert, smooth, cheat, random"):
        controller("expart", compose_settings())
    for task in ("standard", "peg_transfer", "reach"):
        settings = compose_settings([f"task={task}", "episode.control=pose"])
        with pytest.raises(ValueError, match=r"episode\.control"):
            controller("smooth", settings)
