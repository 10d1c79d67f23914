"""The networks: what they read, what they write, where they start."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from needlehoop.config import composing, strict
from needlehoop.learning.encoder import Encoder, EncoderConfig, Fold
from needlehoop.learning.networks import HeadConfig, Normalizer, PolicySpec, ValueAgent

ENCODERS = sorted(file.stem for file in (composing.CONF / "encoder").glob("*.yaml"))
SMALL = EncoderConfig(name="small", stem=2, channels=(4, 6), blocks=1)
HEADS = HeadConfig(hidden=16, layers=2, sigma=0.6, shared=True, privileged_facts=())


def random_images(*shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)


def make_agent(cameras: dict[str, int], vectors: dict[str, int], **heads) -> ValueAgent:
    """An agent of cameras with so many channels, and of vectors so long."""
    torch.manual_seed(0)
    spec = PolicySpec(cameras, 16, vectors, SMALL, replace(HEADS, **heads), "tool", 5, "fp32")
    return ValueAgent(spec, torch.device("cpu"))


def observed(n: int, cameras: dict[str, int], vectors: dict[str, int]) -> TensorDict:
    """What ``n`` environments may show to such an agent, drawn at random."""
    pixels = {name: random_images(n, channels, 16, 16) for name, channels in cameras.items()}
    facts = {name: torch.rand(n, 1) < 0.5 for name in ("grasped", "lifted")}
    numbers = {name: torch.randn(n, size) for name, size in vectors.items()}
    return TensorDict({"pixels": pixels, "facts": facts, **numbers}, [n])


def outputs(agent: ValueAgent, seen: TensorDict) -> tuple[torch.Tensor, ...]:
    """Mean, deviation and value of an observation."""
    fold, trunk = agent.actor.fold, agent.actor.trunk
    read = [fold(seen[key]) if key[0] == "pixels" else seen[key] for key in agent.seen_keys]
    hidden = trunk(*read)
    of_value = hidden if agent.value_trunk is None else agent.value_trunk(*read)
    facts = [seen[key] for key in agent.privileged_keys]
    return *agent.actor.head(hidden), agent.value(of_value, *facts)


@pytest.mark.parametrize("stem", [1, 4])
def test_an_image_is_folded_into_blocks_and_moved_as_it_would_be_before(stem):
    images, fold = random_images(3, 3, 16, 24), Fold(stem)
    # A block's pixels row by row, each with its channels.
    block = images[0, :, stem : 2 * stem, :stem].permute(1, 2, 0).flatten()
    assert torch.equal(fold(images)[0, 1, 0], block)
    down, right = torch.tensor([0, 3, -2]), torch.tensor([-1, 0, 5])
    wide = torch.nn.functional.pad(images.float(), (5, 5, 5, 5), mode="replicate").byte()
    expected = torch.stack(
        [
            one[:, 5 - y : 21 - y, 5 - x : 29 - x]
            for one, y, x in zip(wide, down.tolist(), right.tolist(), strict=True)
        ]
    )
    assert torch.equal(fold.moved(fold(images), down, right), fold(expected))


def test_an_encoder_gives_a_vector_per_image_about_the_same_in_bfloat16():
    folded = Fold(2)(random_images(5, 3, 16, 16))

    def encoder(dtype: torch.dtype) -> Encoder:
        torch.manual_seed(0)
        return Encoder(torch.Size((3, 16, 16)), SMALL, 8, dtype)

    exact, rough = (encoder(dtype)(folded) for dtype in (torch.float32, torch.bfloat16))
    assert exact.shape == (5, 8)
    assert exact.std() > 0
    single = encoder(torch.float32)(folded.view(1, 5, 8, 8, 12)[:, 2:3])
    torch.testing.assert_close(single[0], exact[2:3])
    assert exact.dtype == rough.dtype == torch.float32
    assert not torch.equal(exact, rough)
    torch.testing.assert_close(rough, exact, rtol=0.0, atol=0.05 * float(exact.detach().max()))


@pytest.mark.parametrize("name", ENCODERS)
def test_every_encoder_of_the_config_reads_an_image_of_the_usual_size(name):
    values = composing.compose(["cams=[dep_front]", f"encoder={name}"], "config")
    config, size = strict.structure(values["encoder"], EncoderConfig), values["image_size"]
    encoder = Encoder(torch.Size((4, size, size)), config, 8, torch.float32)
    assert encoder(Fold(config.stem)(random_images(1, 4, size, size))).shape == (1, 8)


def test_an_image_that_does_not_fit_is_refused_with_what_would():
    narrow = EncoderConfig(name="narrow", stem=4, channels=(4, 4), blocks=1)
    narrow.check_fit(16)
    for size in (12, 66):
        message = rf"image_size: {size} .*encoder=narrow: .*multiple of 4, at least 16$"
        with pytest.raises(ValueError, match=message):
            narrow.check_fit(size)


def test_a_normalizer_knows_mean_and_variance_of_all_it_was_shown():
    generator = torch.Generator().manual_seed(1)
    scale, offset = torch.tensor([0.01, 1.0, 30.0]), torch.tensor([5.0, 0.0, -2.0])
    vectors = torch.randn(60, 3, generator=generator) * scale + offset
    normalizer = Normalizer(3)
    assert torch.equal(normalizer(vectors), vectors)
    first, second, third = vectors.split([7, 41, 12])
    for chunk in (first, second, third.view(4, 3, 3)):
        normalizer.learn(chunk)
    mean, variance = vectors.double().mean(0), vectors.double().var(0, correction=0)
    torch.testing.assert_close(normalizer.mean, mean)
    torch.testing.assert_close(normalizer.square - normalizer.mean**2, variance)
    probe = mean + torch.tensor([-2.0, 0.5, 1e6]) * variance.sqrt()
    seen = normalizer(probe.float())
    assert seen.dtype == torch.float32
    # It clamps at five deviations.
    torch.testing.assert_close(seen, torch.tensor([-2.0, 0.5, 5.0]), atol=1e-3, rtol=0)


def test_an_agent_reads_the_keys_it_names_and_begins_with_the_sigma_of_the_config():
    inputs = {"rgb_a": 3, "dep_b": 4}, {"proprio": 8, "signals": 6}
    agent = make_agent(*inputs)
    assert agent.in_keys == [("pixels", "rgb_a"), ("pixels", "dep_b"), "proprio", "signals"]
    loc, scale, value = outputs(agent, observed(7, *inputs))
    assert value.shape == (7, 1)
    assert loc.std(0).min() > 0
    torch.testing.assert_close(scale, torch.full((7, 5), 0.6))


def test_a_value_function_of_its_own_leaves_the_policy_alone():
    apart, seen = make_agent({"rgb_a": 3}, {}, shared=False), observed(2, {"rgb_a": 3}, {})
    for output, moved in ((0, 0), (2, 1)):
        apart.zero_grad()
        outputs(apart, seen)[output].square().sum().backward()
        grads = [
            [parameter.grad for parameter in trunk.parameters()]
            for trunk in (apart.actor.trunk, apart.value_trunk)
        ]
        assert all(grad is not None for grad in grads[moved])
        assert all(grad is None for grad in grads[1 - moved])


def test_a_privileged_fact_moves_the_value_and_not_the_policy():
    agent = make_agent({"rgb_a": 3}, {}, privileged_facts=("lifted",))
    seen = observed(2, {"rgb_a": 3}, {})
    loc, _, value = outputs(agent, seen)
    for fact, moves in (("grasped", False), ("lifted", True)):
        other = seen.clone()
        other["facts", fact] = ~other["facts", fact]
        loc_after, _, value_after = outputs(agent, other)
        assert torch.equal(loc_after, loc)
        assert torch.equal(value_after, value) != moves
    # The policy alone needs no fact.
    assert torch.equal(agent.actor(seen["pixels", "rgb_a"]), loc.clamp(-1.0, 1.0))
