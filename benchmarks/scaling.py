"""What more cores would bring to training, by Amdahl's law.

    python benchmarks/scaling.py 3

The words are those of ``benchmarks/training.py``, which is run with all threads and with one, in
processes of their own. The ratio gives the share of the time that does not shrink with cores.
"""

import json
import subprocess
import sys
from pathlib import Path

CORES = (4, 8, 16, 64)


def serial_share(ratio: float, threads: int) -> float:
    """Share of the time on one thread that does not shrink, from a measured speed-up.

    Args:
        ratio: rate with ``threads`` over the rate with one.
        threads: at least 2.
    """
    return min(1.0, max(0.0, (threads / ratio - 1.0) / (threads - 1.0)))


def predict(rate: float, serial: float) -> dict[int, int]:
    """Rates by number of cores, from the rate on one and the share that does not shrink."""
    return {cores: round(rate / (serial + (1.0 - serial) / cores)) for cores in CORES}


def measured(*words: str) -> dict:
    """What ``benchmarks/training.py`` says."""
    command = [sys.executable, Path(__file__).with_name("training.py"), *words]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    whole = measured(*sys.argv[1:])
    single = measured(*sys.argv[1:], "engine.threads=1")
    threads = whole["threads"]
    if threads == 1:
        sys.exit("this machine has one core: nothing to compare")
    ratio = whole["steps_per_second"] / single["steps_per_second"]
    serial = serial_share(ratio, threads)
    for count, report in ((threads, whole), (1, single)):
        share = report["share_learning"]
        print(f"{count} threads: {report['steps_per_second']} steps/s, {share:.0%} of it learning")
    print(f"ratio {ratio:.2f}, serial share {serial:.3f}")
    print("predicted:", predict(single["steps_per_second"], serial))
