"""What ``pip install .`` brings: a wheel that works in any folder, without the checkout."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from needlehoop.runs.files import POLICY
from needlehoop.runs.shipped import AGENTS

ROOT = Path(__file__).parent.parent
SCRIPT = """
import contextlib, io, json, sys
import needlehoop
from needlehoop.config import composing
from needlehoop.cli.main import main
from needlehoop.learning.job import typed_job
from needlehoop.runs.shipped import AGENT, RECORDINGS, agent_of

said = []
ASKED = (["tasks", "task=standard"], ["--help"], ["train", "--help"])
for words in (*ASKED, ["train", "cams=dep_front", "stpes=9"]):
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            main(words)
        except SystemExit as end:
            print(end.code)
    said.append(out.getvalue())
values = composing.compose(["cams=dep_front,seg_side", "reward=vlm_img"], "config")
print(json.dumps({
    "places": [needlehoop.__file__, str(composing.CONF), str(RECORDINGS), str(AGENT),
               str(agent_of("reach/wide"))],
    "run": typed_job(values).place,
    "said": said,
}))
"""


# Building it takes half a minute.
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of this source, built in a copy, without a network."""
    folder = tmp_path_factory.mktemp("source")
    for name in ("needlehoop", "conf", *AGENTS.values()):
        leave = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, folder / name, ignore=leave)
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    words = ["wheel", ".", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", "out"]
    done = subprocess.run(
        [sys.executable, "-m", "pip", *words], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (built,) = (folder / "out").iterdir()
    return built


def test_a_wheel_carries_every_file_of_the_package_and_of_conf(wheel):
    def files(folder: Path, below: str) -> set[str]:
        paths = (path for path in folder.rglob("*") if path.is_file())
        return {f"{below}/{path.relative_to(folder)}" for path in paths if path.suffix != ".pyc"}

    with zipfile.ZipFile(wheel) as held:
        carried = {name for name in held.namelist() if ".dist-info/" not in name}
    agents = {
        f"needlehoop/{agent}/{name}"
        for agent in AGENTS
        for name in ("config.yaml", "manifest.json", POLICY)
    }
    assert carried == (
        files(ROOT / "needlehoop", "needlehoop") | files(ROOT / "conf", "needlehoop/conf") | agents
    )


def test_an_install_needs_no_checkout(wheel, tmp_path):
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    with zipfile.ZipFile(wheel) as held:
        held.extractall(site)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=elsewhere,
        env={"PYTHONPATH": str(site), "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert [place for place in result["places"] if not place.startswith(f"{site}/")] == []
    assert result["run"] == "main/dep_front+seg_side/vlm_img/seed0"
    signals, *_, misspelt = result["said"]
    assert "needle_tip" in signals
    assert "stpes: unknown key" in misspelt
    assert list(elsewhere.iterdir()) == []
