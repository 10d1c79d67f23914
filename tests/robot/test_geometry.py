from __future__ import annotations

from collections.abc import Callable

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given
from scipy.spatial.transform import Rotation
from torch import Tensor

from needlehoop.robot import geometry as geo

numbers = st.floats(-10.0, 10.0, allow_nan=False, width=64)
vectors = st.tuples(numbers, numbers, numbers)
turns = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 0.1)


def tensor(values) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def unit(values) -> Tensor:
    quat = tensor(values)
    return quat / quat.norm()


def as_scipy(quat: Tensor) -> Rotation:
    w, x, y, z = quat.tolist()
    return Rotation.from_quat([x, y, z, w])


def close(actual: Tensor, expected, tolerance: float = 1e-9) -> None:
    torch.testing.assert_close(actual, torch.as_tensor(expected), rtol=0, atol=tolerance)


@given(turns, vectors)
def test_rotate_turns_as_scipy_does_and_the_conjugate_undoes_it(turn, vector):
    quat, v = unit(turn), tensor(vector)
    turned = geo.rotate(quat, v)
    close(turned, as_scipy(quat).apply(vector))
    close(geo.rotate(geo.conjugate(quat), turned), v)


@given(turns, turns, vectors)
def test_a_product_turns_by_the_second_and_then_by_the_first(one, other, vector):
    first, second, v = unit(one), unit(other), tensor(vector)
    close(
        geo.rotate(geo.multiply(first, second), v),
        geo.rotate(first, geo.rotate(second, v)),
    )


@given(turns, vectors)
def test_the_matrix_and_the_quaternion_turn_alike(turn, vector):
    quat, v = unit(turn), tensor(vector)
    close(geo.to_matrix(quat) @ v, geo.rotate(quat, v))
    close(geo.to_matrix(quat), as_scipy(quat).as_matrix())


@given(vectors)
def test_a_rotation_vector_becomes_the_turn_that_scipy_makes_of_it(vector):
    quat = geo.from_rotation_vector(tensor(vector))
    close(quat.norm(), tensor(1.0))
    close(geo.to_matrix(quat), Rotation.from_rotvec(vector).as_matrix())


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-15, 1e-12, 1e-9, 1e-6])
def test_a_tiny_rotation_vector_is_half_of_itself(size):
    """The quotient sin(x/2)/x has to survive x = 0."""
    quat = geo.from_rotation_vector(tensor([size, -size, 0.0]))
    assert quat.tolist() == pytest.approx([1.0, size / 2, -size / 2, 0.0], rel=1e-9, abs=1e-15)


@given(st.floats(-7.0, 7.0))
def test_about_z_turns_x_towards_y(angle):
    turned = geo.rotate(geo.about_z(tensor(angle)), tensor([1.0, 0.0, 0.0]))
    close(turned, tensor([np.cos(angle), np.sin(angle), 0.0]))


@given(vectors, vectors)
def test_products_and_distance_are_numpys(one, other):
    a, b = tensor(one), tensor(other)
    close(geo.dot(a, b), np.dot(one, other))
    close(geo.cross(a, b), np.cross(one, other))
    close(geo.distance(a, b), np.linalg.norm(np.subtract(one, other)))


FUNCTIONS: dict[str, tuple[Callable[..., Tensor], tuple[int, ...]]] = {
    "dot": (geo.dot, (3, 3)),
    "distance": (geo.distance, (3, 3)),
    "rotate": (geo.rotate, (4, 3)),
    "cross": (geo.cross, (3, 3)),
    "multiply": (geo.multiply, (4, 4)),
    "conjugate": (geo.conjugate, (4,)),
    "from_rotation_vector": (geo.from_rotation_vector, (3,)),
    "to_matrix": (geo.to_matrix, (4,)),
    "aside": (geo.aside, (3,)),
    "about_z": (lambda angle: geo.about_z(angle[:, 0]), (1,)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("count", [2, 7, 257])
def test_a_row_is_the_same_bits_in_a_batch_of_any_size(name, count):
    function, widths = FUNCTIONS[name]
    generator = torch.Generator().manual_seed(count)
    inputs = [torch.randn(count, w, generator=generator, dtype=torch.float64) for w in widths]
    together = function(*inputs)
    apart = [function(*(rows[i : i + 1] for rows in inputs)) for i in range(count)]
    assert torch.equal(together, torch.cat(apart))
