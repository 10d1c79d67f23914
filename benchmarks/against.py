"""Training's speed here and in another checkout of needlehoop, in turns.

    python benchmarks/against.py ../other-checkout 3 2

The words are the other checkout's folder, the number of turns, and the words of
``benchmarks/training.py``, which both checkouts need to have. Both run on this Python and its
packages, in processes of their own.
"""

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parents[1]


def rate(root: Path, words: list[str]) -> float:
    """Training steps per second in a checkout, by its own ``benchmarks/training.py``.

    Raises:
        RuntimeError: the script failed.
    """
    done = subprocess.run(
        [sys.executable, root / "benchmarks/training.py", *words],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"{root}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    return float(json.loads(done.stdout.splitlines()[-1])["steps_per_second"])


if __name__ == "__main__":
    other, turns, *words = sys.argv[1:]
    pairs = []
    for turn in range(int(turns)):
        pairs.append((rate(HERE, words), rate(Path(other).resolve(), words)))
        print(f"turn {turn + 1}: here {pairs[-1][0]:.0f}, there {pairs[-1][1]:.0f} steps/s")
    print(f"here : there {statistics.median(here / there for here, there in pairs):.2f}")
