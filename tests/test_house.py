"""The plan of the house: which package may know which."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import needlehoop

HOME = Path(needlehoop.__file__).parent

FLOORS = (
    "runs",
    "config",
    "robot",
    "scene",
    "tasks",
    "rewards",
    "engines",
    "disturbances",
    "envs",
    "pictures",
    "gym",
    "learning",
    "study",
    "vlm",
    "probe",
    "demonstrations",
    "api",
    "training",
    "studio",
    "cli",
)
"""Packages, from the ground up; each may import those before it."""

FILES_ONLY = {"study": {"runs"}, "runs": set()}
"""They read files: no simulator, and nothing that needs one."""
HEAVY = re.compile(
    r"(?m)^ *(import|from) (torch|mujoco|dm_control|hydra)\b|runs(\.| import )(run|machine)\b"
)
"""What a study is read without; the two modules of ``runs`` need torch."""

MODULES = sorted(path for path in HOME.rglob("*.py") if path != HOME / "__init__.py")


def room(path: Path) -> str:
    """The package that a file belongs to."""
    return path.relative_to(HOME).parts[0]


def imported(source: str) -> set[str]:
    """Rooms that a source imports, at its top or when a function runs."""
    rooms = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module == "needlehoop":
            names = [f"needlehoop.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            continue
        rooms |= {name.split(".")[1] for name in names if name.startswith("needlehoop.")}
    return rooms


def test_every_room_has_a_floor_and_no_file_stands_outside():
    assert {room(path) for path in MODULES} == set(FLOORS)


def test_imports_go_down():
    for path in MODULES:
        below = set(FLOORS[: FLOORS.index(room(path)) + 1])
        assert imported(path.read_text()) <= below, path


def test_those_that_read_files_import_nothing_else():
    for name, known in FILES_ONLY.items():
        for path in (HOME / name).rglob("*.py"):
            assert imported(path.read_text()) <= {name, *known}, path
            assert name != "study" or not HEAVY.search(path.read_text()), path


def test_every_package_says_what_lives_there():
    for init in HOME.rglob("*/__init__.py"):
        assert ast.get_docstring(ast.parse(init.read_text())), init
