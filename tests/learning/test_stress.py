from __future__ import annotations

import csv

from needlehoop.cli.main import main
from needlehoop.disturbances.axes import AXES
from needlehoop.envs.controllers import by_name
from needlehoop.envs.settings import compose_settings
from needlehoop.learning.stress import Condition, conditions, stress

LEVELS = {
    group: {key.partition(".")[2]: (1.0, 2.0) for key in AXES if key.startswith(group)}
    for group in ("camera", "picture", "scene", "robot")
}


def test_conditions_are_none_each_axis_and_all():
    tried = conditions(LEVELS, ["camera.shift", "robot.late"], [2, 1], 2)
    assert [(c.axis, c.severity) for c in tried] == [
        ("none", 0), ("camera.shift", 1), ("camera.shift", 2), ("robot.late", 1),
        ("robot.late", 2), ("all", 2),
    ]  # fmt: skip
    assert tried[-1].amounts == {"camera.shift": 2.0, "robot.late": 2.0}


def test_the_result_does_not_depend_on_the_batch():
    settings = compose_settings(["seed=3", "task=near"])
    tried = [
        Condition("none", 0, {}),
        Condition("robot.late", 3, {"robot.late": 6.0}),
        Condition("robot.offset", 3, {"robot.offset": 0.02}),
    ]
    rows = [stress(settings, by_name("smooth"), tried, 6, size) for size in (4, 18)]
    assert rows[0] == rows[1]
    none, late, offset = rows[0]
    assert none["success"] == 1.0
    assert late["steps"] > none["steps"]
    assert offset["success"] < 1.0
    assert (none["episodes"], late["amount"], late["unit"]) == (6, 6.0, "steps")


def test_the_command_tests_a_controller(tmp_path, capsys):
    out = tmp_path / "stress.csv"
    words = ["stress", "smooth", "task=reach", "axes=robot.offset", "severities=1,5", "episodes=4"]
    assert main([*words, f"out={out}", "threads=1"]) == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [(row["axis"], row["severity"]) for row in rows] == [
        ("none", "0"), ("robot.offset", "1"), ("robot.offset", "5"), ("all", "3"),
    ]  # fmt: skip
    assert rows[0]["success"] == "1.0"
    assert "undisturbed  100.0%" in capsys.readouterr().out
