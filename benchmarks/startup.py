"""How long commands take that need no simulator and no agent, beside ``import torch``.

    python benchmarks/startup.py 6

The word is the number of rounds. The calls take turns; a ratio is the median of those within a
round.
"""

import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

HERE = Path(__file__).parents[1]
COMMAND = ("-m", "needlehoop.cli.main")
BAD = "bad.txt"

CALLS = {
    "import torch": (("-c", "import torch"), 0),
    "--help": ((*COMMAND, "--help"), 0),
    "tasks": ((*COMMAND, "tasks"), 0),
    "status": ((*COMMAND, "status", "study", "experiment=table2"), 0),
    "vlm check of a program that does not compile": ((*COMMAND, "vlm", "check", BAD), 1),
    "train --help": ((*COMMAND, "train", "--help"), 0),
    "train with a misspelt key": ((*COMMAND, "train", "cams=dep_front", "stpes=9"), 1),
}
"""Words after ``python``, and the exit status that they must end with."""


def seconds(words: tuple[str, ...], status: int, folder: str) -> float:
    """Seconds that one call of Python in a folder takes.

    Raises:
        RuntimeError: the call ended with another exit status.
    """
    paths = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    taken = time.perf_counter() - began
    if done.returncode != status:
        raise RuntimeError(f"{' '.join(words)}: exit status {done.returncode}, not {status}")
    return taken


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        (Path(folder) / BAD).write_text("reward = nonsense(needle_tip)\n")
        # The first round reads the files from the disk, and may compile them: one more.
        rounds = [
            {name: seconds(words, status, folder) for name, (words, status) in CALLS.items()}
            for _ in range(int(sys.argv[1]) + 1)
        ][1:]
    for name in CALLS:
        taken = median(one[name] for one in rounds)
        ratio = median(one[name] / one["import torch"] for one in rounds)
        print(f"{name}: {taken:.2f} s, {ratio:.2f} of import torch")
