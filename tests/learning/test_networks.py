"""The networks: what they read, what they write, where they start."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDictBase
from torch.nn.functional import pixel_unshuffle
from torchrl.data import Binary, Bounded, Composite, Unbounded

from needlehoop.config import composing, strict
from needlehoop.learning.agent import ValueAgent
from needlehoop.learning.encoder import Encoder, EncoderConfig, Fold, convolution_dtype
from needlehoop.learning.networks import HeadConfig, Normalizer, PolicySpec, Trunk

ENCODERS = sorted(file.stem for file in (composing.CONF / "encoder").glob("*.yaml"))
SMALL = EncoderConfig(name="small", stem=2, channels=(4, 6), blocks=1)
HEADS = HeadConfig(hidden=16, layers=2, sigma=0.6, shared=True, told=())


def random_images(*shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, shape, dtype=torch.uint8, generator=generator)


def observed(n: int, cameras: dict[str, int], vectors: dict[str, int]) -> Composite:
    """An observation spec like the environment's: channels by camera, lengths by vector."""
    spec = Composite(shape=(n,))
    if cameras:
        pixels = Composite(shape=(n,))
        for name, channels in cameras.items():
            pixels[name] = Bounded(0, 255, shape=(n, channels, 16, 16), dtype=torch.uint8)
        spec["pixels"] = pixels
    for name, size in vectors.items():
        spec[name] = Unbounded(shape=(n, size))
    spec["potential"] = Unbounded(shape=(n, 1))
    return spec


def make_agent(spec: Composite, encoder: EncoderConfig = SMALL, **heads) -> ValueAgent:
    torch.manual_seed(0)
    seen = dict(spec.items())
    channels = {name: one.shape[1] for name, one in seen.get("pixels", {}).items()}
    vectors = {name: seen[name].shape[-1] for name in ("proprio", "signals") if name in seen}
    own = PolicySpec(channels, 16, vectors, encoder, replace(HEADS, **heads), "tool", 5, "fp32")
    return ValueAgent(own, torch.float32)


def said(agent: ValueAgent, seen: TensorDictBase) -> tuple[torch.Tensor, ...]:
    """Mean, deviation and value of an observation."""
    folded = seen.clone()
    for name, image in seen["pixels"].items() if "pixels" in seen else ():
        folded["pixels", name] = agent.fold(image)
    common, head, value = agent.torchrl()
    found = value(head.module[0](common(folded.select(*agent.in_keys))))
    return found["loc"], found["scale"], found["state_value"]


@pytest.mark.parametrize("stem", [1, 4])
def test_a_folded_image_is_moved_as_it_would_be_before(stem):
    images, fold = random_images(3, 3, 16, 24), Fold(stem)
    down, right = torch.tensor([0, 3, -2]), torch.tensor([-1, 0, 5])
    wide = torch.nn.functional.pad(images.float(), (5, 5, 5, 5), mode="replicate").byte()
    expected = torch.stack(
        [
            one[:, 5 - y : 21 - y, 5 - x : 29 - x]
            for one, y, x in zip(wide, down.tolist(), right.tolist(), strict=True)
        ]
    )
    assert torch.equal(fold.moved(fold(images), down, right), fold(expected))


@pytest.mark.parametrize("stem", [2, 4])
def test_fold_is_pixel_unshuffle_with_its_channels_in_another_order(stem):
    image = random_images(3, 4, 16, 8)
    folded = Fold(stem)(image)
    assert folded.dtype == torch.uint8
    assert folded.shape == (3, 16 // stem, 8 // stem, 4 * stem**2)
    ours = sorted(plane.flatten().tolist() for plane in folded.unbind(-1))
    expected = pixel_unshuffle(image, stem)
    assert ours == sorted(plane.flatten().tolist() for plane in expected.unbind(1))
    assert torch.equal(Fold(stem)(image[None])[0], folded)


def make_encoder(dtype: torch.dtype) -> Encoder:
    torch.manual_seed(0)
    return Encoder(torch.Size((3, 16, 16)), SMALL, 8, dtype)


def test_an_encoder_gives_a_float32_vector_per_image():
    folded = Fold(2)(random_images(5, 3, 16, 16))
    encoder = make_encoder(torch.float32)
    features = encoder(folded)
    assert features.shape == (5, 8)
    assert features.dtype == torch.float32
    assert features.std() > 0
    torch.testing.assert_close(encoder(folded[2:3]), features[2:3])
    torch.testing.assert_close(encoder(folded.view(1, 5, 8, 8, 12)), features.unsqueeze(0))


def test_an_encoder_in_bfloat16_gives_about_the_same_in_float32():
    folded = Fold(2)(random_images(5, 3, 16, 16))
    exact, rough = (make_encoder(dtype)(folded) for dtype in (torch.float32, torch.bfloat16))
    assert rough.dtype == torch.float32
    assert not torch.equal(exact, rough)
    torch.testing.assert_close(rough, exact, rtol=0.0, atol=0.05 * float(exact.detach().max()))


@pytest.mark.parametrize("name", ENCODERS)
def test_every_encoder_of_the_config_reads_an_image_of_the_usual_size(name):
    values = composing.compose(["cams=[dep_front]", f"encoder={name}"], "config")
    own, size = strict.structure(values["encoder"], EncoderConfig), values["image_size"]
    encoder = Encoder(torch.Size((4, size, size)), own, 8, torch.float32)
    assert encoder(Fold(own.stem)(random_images(1, 4, size, size))).shape == (1, 8)


@pytest.mark.parametrize(
    ("stem", "size", "multiple", "least"), [(4, 66, 4, 16), (2, 6, 2, 8), (1, 3, 1, 4)]
)
def test_an_image_that_does_not_fit_is_refused_with_what_would(stem, size, multiple, least):
    narrow = EncoderConfig(name="narrow", stem=stem, channels=(4, 4), blocks=1)
    said = rf"image_size: {size} .*encoder=narrow: .*multiple of {multiple}, at least {least}$"
    with pytest.raises(ValueError, match=said):
        Encoder(torch.Size((3, size, size)), narrow, 8, torch.float32)
    Encoder(torch.Size((3, least, least)), narrow, 8, torch.float32)


def test_both_ways_of_halving_make_maps_of_the_same_size():
    shape = torch.Size((3, 24, 16))
    pooled, strided = (
        Encoder(shape, EncoderConfig("small", 2, (4, 4), 1, halving), 8, torch.float32)
        for halving in ("pool", "stride")
    )
    assert pooled.dense[0].in_features == strided.dense[0].in_features == 4 * 3 * 2
    assert not [module for module in strided.modules() if isinstance(module, torch.nn.MaxPool2d)]


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
    spec = observed(7, {"rgb_a": 3, "dep_b": 4}, {"proprio": 8, "signals": 6})
    agent = make_agent(spec)
    assert agent.in_keys == [("pixels", "rgb_a"), ("pixels", "dep_b"), "proprio", "signals"]
    loc, scale, value = said(agent, spec.rand())
    assert value.shape == (7, 1)
    assert loc.std(0).min() > 0
    torch.testing.assert_close(scale, torch.full((7, 5), 0.6))


def test_every_camera_has_an_encoder_of_its_own():
    spec = observed(2, {"rgb_a": 3, "rgb_b": 3}, {})
    agent = make_agent(spec)
    first, second = (module for module in agent.modules() if isinstance(module, Encoder))
    pairs = list(zip(first.parameters(), second.parameters(), strict=True))
    assert all(ours is not theirs for ours, theirs in pairs)
    assert not torch.equal(first.dense[0].weight, second.dense[0].weight)
    said(agent, spec.rand())[0].square().sum().backward()
    for encoder in (first, second):
        assert all(parameter.grad.abs().max() > 0 for parameter in encoder.parameters())


def test_a_value_function_of_its_own_leaves_the_policy_alone():
    spec = observed(2, {"rgb_a": 3}, {})
    apart = make_agent(spec, shared=False)
    for output, moved in ((0, 0), (2, 1)):
        apart.zero_grad()
        said(apart, spec.rand())[output].square().sum().backward()
        grads = [
            [parameter.grad for parameter in trunk.parameters()]
            for trunk in apart.modules()
            if isinstance(trunk, Trunk)
        ]
        assert all(grad is not None for grad in grads[moved])
        assert all(grad is None for grad in grads[1 - moved])


def test_a_privileged_fact_moves_the_value_and_not_the_policy():
    spec = observed(2, {"rgb_a": 3}, {})
    flag = Binary(1, shape=(2, 1), dtype=torch.bool)
    spec["facts"] = Composite(grasped=flag, lifted=flag.clone(), shape=(2,))
    agent, seen = make_agent(spec, told=("lifted",)), spec.rand()
    loc, _, value = said(agent, seen)
    for fact, moves in (("grasped", False), ("lifted", True)):
        other = seen.clone()
        other["facts", fact] = ~other["facts", fact]
        loc_after, _, value_after = said(agent, other)
        assert torch.equal(loc_after, loc)
        assert torch.equal(value_after, value) != moves
    # The policy alone needs no fact.
    assert torch.equal(agent.actor(seen["pixels", "rgb_a"]), loc)
    assert not [name for name in agent.state_dict() if "actor" in name]


@pytest.mark.parametrize(("has", "dtype"), [(True, torch.bfloat16), (False, torch.float32)])
@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_precision_auto_is_bfloat16_where_the_processor_has_it(monkeypatch, device, has, dtype):
    monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda: has == (device == "cpu"))
    monkeypatch.setattr(
        torch.cuda, "is_bf16_supported", lambda including_emulation: has == (device == "cuda")
    )
    assert convolution_dtype("auto", torch.device(device)) == dtype
    assert convolution_dtype("fp32", torch.device(device)) == torch.float32
    assert convolution_dtype("bf16", torch.device(device)) == torch.bfloat16
