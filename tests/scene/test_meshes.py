"""Generated meshes."""

import numpy as np
import pytest

from needlehoop.scene.shapes import torus, tube


@pytest.mark.parametrize(
    "mesh",
    [
        tube(np.stack((np.linspace(0, 1, 9), np.linspace(0, 1, 9) ** 2, np.zeros(9)), -1), 0.1),
        torus(0.5, 0.1),
    ],
)
def test_generated_meshes_face_outwards(mesh):
    first, second, third = mesh.vertices[mesh.faces].swapaxes(0, 1)
    assert np.sum(first * np.cross(second, third)) > 0
