"""``needlehoop tasks``: the tasks that there are."""

from __future__ import annotations

import argparse
from typing import Any


def add_commands(commands: Any) -> None:
    """Add the command to the subparsers of ``needlehoop``."""
    summary = "List the tasks: their facts, phases, controllers and variants."
    listed = commands.add_parser("tasks", help=summary, description=summary)
    listed.add_argument(
        "overrides", nargs="*", metavar="key=value", help="task_dir=<folder> conf_dir=<folder>"
    )
    listed.set_defaults(run=_tasks)


def _tasks(options: argparse.Namespace) -> None:
    from needlehoop.config.own_folder import part, task_folder
    from needlehoop.config.task_options import variants
    from needlehoop.runs.shipped import CONF
    from needlehoop.tasks.registry import add_folder, find, names

    for word in options.overrides:
        key = word.partition("=")[0]
        if key not in ("conf_dir", "task_dir"):
            raise ValueError(f"{key}: unknown key; choose from conf_dir, task_dir")
    _, folders = part(options.overrides)
    if own := task_folder(options.overrides):
        add_folder(own)
    for name in names():
        task = find(name)
        print(f"{name}: {task.summary}")
        for fact in task.facts:
            row = task.signals[fact.name]
            told = " (kept from reward writers)" if row.source == "verdict" else ""
            print(f"  fact        {fact.name}: {row.meaning}{told}")
        print(f"  phases      {', then '.join(f'{p.name} until {p.ends}' for p in task.phases)}")
        print(f"  controllers {', '.join(task.controllers)}; {task.teacher} is imitated")
        print(f"  variants    {', '.join(variants(name, [CONF, *folders]))}")
