"""The tour runs from its first cell to its last, on few steps."""

import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parent.parent

FEW = """STEPS = 64
MORE = ["num_envs=4", "algo.horizon=8", "algo.minibatch=16", "algo.minibatches=2"]
MORE += ["image_size=32", "episode.max_steps=6", "evaluation.every=9", "engine.threads=1"]
"""

# In a process of its own: a kernel's client leaves sockets and event loops for the garbage
# collector, whose warnings would be errors here.
EXECUTE = """
import sys, nbformat
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=300, kernel_name="python3").execute()
nbformat.write(book, sys.argv[1])
"""


@pytest.mark.full
def test_the_tour_runs(tmp_path):
    tour = nbformat.read(ROOT / "examples/tour.ipynb", 4)
    cells = [cell for cell in tour.cells if "parameters" in cell.metadata.get("tags", ())]
    assert len(cells) == 1
    cells[0].source = FEW
    book = tmp_path / "tour.ipynb"
    nbformat.write(tour, book)
    done = subprocess.run(
        [sys.executable, "-c", EXECUTE, str(book)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    run = nbformat.read(book, 4)
    outputs = [cell.outputs for cell in run.cells if cell.cell_type == "code"]
    assert "threaded in" in outputs[-1][0].text
