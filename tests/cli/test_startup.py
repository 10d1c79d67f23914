"""Commands that need no simulator and no agent do not wait for either."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

HEAVY = (
    *("tensordict", "torchrl", "torch._dynamo", "mujoco", "mujoco_warp", "warp", "dm_control"),
    *("pytorch_kinematics", "matplotlib", "scipy.stats", "wandb", "imageio"),
    *("needlehoop.learning.learner", "needlehoop.engines.engine", "needlehoop.engines.tracer"),
)
"""What takes seconds to import, or brings it along."""

WITHOUT_TORCH = [
    ["--help"],
    ["status", "."],
    ["evaluate", "--help"],
    ["train", "--help"],
]

MISSPELT = [
    ["train", "cams=dep_front", "stpes=9"],
    ["vlm", "rank", "sampels=3"],
]

WITH_TORCH = [
    ["vlm", "check", "bad.txt"],
    ["expert", "seed=-1"],
    ["evaluate", str(ROOT / "results/table2/rgb_default/human/seed0"), "episods=1"],
]

SCRIPT = """
import contextlib, io, json, sys
from needlehoop.cli.main import main
commands, names, results = *map(json.loads, sys.argv[1:]), {}
for words in commands:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            status = main(words)
        except SystemExit as end:
            status = end.code
    results[" ".join(words)] = [str(status), [name for name in names if name in sys.modules]]
print(json.dumps(results))
"""


def imported(commands: list[list[str]], names: tuple[str, ...], folder: Path) -> dict[str, list]:
    """Exit status and which of the modules are imported, after one command and the next."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, json.dumps(commands), json.dumps(names)],
        cwd=folder,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_tables_files_help_and_misspelt_keys_need_no_torch(tmp_path):
    results = imported([*WITHOUT_TORCH, *MISSPELT], (*HEAVY, "torch"), tmp_path)
    assert {name: modules for name, (_, modules) in results.items() if modules} == {}
    fine = [name for name, (status, _) in results.items() if status == "0"]
    assert fine == [" ".join(words) for words in WITHOUT_TORCH]
    assert list(tmp_path.iterdir()) == []


def test_what_is_refused_or_explained_needs_no_simulator_and_no_agent(tmp_path):
    (tmp_path / "bad.txt").write_text("reward = nonsense(needle_tip)\n")
    # A task names its sensors with MuJoCo's own types, which take a tenth of a second.
    results = imported(WITH_TORCH, [name for name in HEAVY if name != "mujoco"], tmp_path)
    assert {name: modules for name, (_, modules) in results.items() if modules} == {}
    assert [name for name, (status, _) in results.items() if status == "0"] == []
    assert [path.name for path in tmp_path.iterdir()] == ["bad.txt"]
