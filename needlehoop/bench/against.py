"""Training's speed here and in another checkout, in turns."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import needlehoop
from needlehoop.bench.waiting import rounds_of

_COMMAND = """
import sys
sys.modules["gymnasium"] = None  # Older checkouts would measure Stable-Baselines3 as well.
from {module} import main
sys.exit(main(sys.argv[1:]))
"""

HERE = Path(needlehoop.__file__).parent.parent


def compare_training(other: Path, words: Sequence[str], turns: int) -> dict[str, object]:
    """Run ``bench train`` here and there, in processes of their own, in turns.

    Args:
        other: root of the other checkout; both run on this Python and its packages.
        words: what either is told.
        turns: of each.

    Raises:
        ValueError: fewer than one turn, or a folder that is no checkout.
        RuntimeError: one of them failed.
    """
    if turns < 1:
        raise ValueError(f"turns: {turns} must be at least 1")
    # Before minutes are spent here.
    _module(other)
    pairs = [(_rate(HERE, words), _rate(other, words)) for _ in rounds_of(turns, "turn")]
    ours, theirs = zip(*pairs, strict=True)
    return {
        "here": ours,
        "there": theirs,
        "ratio": round(statistics.median(a / b for a, b in pairs), 2),
        "ratio_by_turn": [round(a / b, 2) for a, b in pairs],
    }


def _rate(root: Path, words: Sequence[str]) -> float:
    code = _COMMAND.format(module=_module(root))
    config = root / "conf/bench_train.yaml"
    alone = ["alone=true"] if config.exists() and "alone:" in config.read_text() else []
    done = subprocess.run(
        [sys.executable, "-c", code, "bench", "train", "--json", *words, *alone],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{root}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    return float(json.loads(done.stdout.splitlines()[-1])["steps_per_second"])


def _module(root: Path) -> str:
    """The module of a checkout's ``needlehoop`` command, which has moved between commits."""
    project = root / "pyproject.toml"
    try:
        command = tomllib.loads(project.read_text())["project"]["scripts"]["needlehoop"]
    except (OSError, KeyError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"against: {root} is no checkout of needlehoop") from error
    return str(command).partition(":")[0]
