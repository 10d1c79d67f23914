"""The tour runs from its first cell to its last, on few steps, and is kept small."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

TOUR = Path(__file__).parent.parent / "examples/tour.ipynb"

FEW = """STEPS = 64
MORE = ["num_envs=4", "algo.horizon=8", "algo.minibatch=16", "algo.minibatches=2"]
MORE += ["image_size=32", "episode.max_steps=6", "evaluation.every=9", "engine.threads=1"]
"""


@pytest.fixture
def tour():
    return nbformat.read(TOUR, 4)


# Asyncio's, of a kernel that was told to stop.
@pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)
def test_the_tour_runs(tour, tmp_path):
    cells = [cell for cell in tour.cells if "parameters" in cell.metadata.get("tags", ())]
    assert len(cells) == 1
    cells[0].source = FEW
    where = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(tour, timeout=300, kernel_name="python3", resources=where).execute()
    said = [cell.outputs for cell in tour.cells if cell.cell_type == "code"]
    assert "threaded in" in said[-1][0].text


def test_its_outputs_are_small(tour):
    assert TOUR.stat().st_size < 200_000
    outputs = [out for cell in tour.cells if cell.cell_type == "code" for out in cell.outputs]
    assert not [out for out in outputs if out.output_type == "error"]
