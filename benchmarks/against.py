"""Training's speed here and in another checkout of needlehoop, in turns.

    python benchmarks/against.py ../other-checkout 3 rounds=2

The words are the other checkout's folder, the number of turns, and settings of
``needlehoop bench train``. Both run on this Python and its packages, in processes of their own.
"""

import json
import os
import statistics
import subprocess
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parents[1]

COMMAND = """
import sys
sys.modules["gymnasium"] = None  # Older checkouts would measure Stable-Baselines3 as well.
from {module} import main
sys.exit(main(sys.argv[1:]))
"""


def rate(root: Path, words: list[str]) -> float:
    """Training steps per second in a checkout, by its own ``needlehoop bench train``.

    Raises:
        RuntimeError: the command failed.
    """
    # The command's module has moved between commits.
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    module = project["scripts"]["needlehoop"].partition(":")[0]
    config = root / "conf/bench_train.yaml"
    alone = ["alone=true"] if config.exists() and "alone:" in config.read_text() else []
    code = COMMAND.format(module=module)
    done = subprocess.run(
        [sys.executable, "-c", code, "bench", "train", "--json", *words, *alone],
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
