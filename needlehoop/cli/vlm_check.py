"""``needlehoop vlm check``."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path
from typing import Any

_OWN = "FILE, flavour, study, recording, sample, unit"
"""What says which program, and how it is read."""


def add_check_command(commands: Any) -> None:
    """Add the command that judges a reward program.

    Args:
        commands: the subparsers of ``needlehoop vlm``.
    """
    summary = "Compile a reward program, put it through the gates, print its card."
    check = commands.add_parser(
        "check",
        help=summary,
        description=f"{summary} Exit status 1 where it is refused.",
        epilog="Keys: gates.range=refuse|clip gates.margin=2 gates.audit=flag|refuse and the rest"
        " of conf/gates; without FILE, cams=[dep_front,seg_side] flavour=image|text study=main"
        " recording=paper sample=1; unit=0.1 (m per scene unit of the program); and all of"
        " conf/env.yaml but the reward.",
    )
    check.add_argument("overrides", nargs="*", metavar="FILE | key=value")
    check.add_argument("--json", action="store_true", help="print one line of JSON")
    check.set_defaults(run=_check, command="vlm check")


def _check(options: argparse.Namespace) -> int:
    from needlehoop.config import composing, strict
    from needlehoop.config.strict import Count
    from needlehoop.rewards.language.grammar import ProgramError
    from needlehoop.rewards.language.program import compile_program
    from needlehoop.rewards.written import find, read, scaled
    from needlehoop.runs.files import check_name
    from needlehoop.vlm.gates import Gates

    files = [word for word in options.overrides if "=" not in word]
    if len(files) > 1:
        raise ValueError(f"one file at a time; got {' '.join(files)}")
    words = [word for word in options.overrides if "=" in word]
    for word in words:
        if re.match(r"reward\b", word):
            raise ValueError(
                f"{word}: the program is judged, no other reward; choose from its {_OWN}"
            )
    values = composing.compose(words, "check")
    from needlehoop.envs.settings import settings_from

    settings = settings_from(values)
    gates = strict.as_type(values["gates"], Gates, "gates")
    flavour, study, results = (
        strict.value(values, key, str) for key in ("flavour", "study", "results")
    )
    recording = strict.value(values, "recording", str | None)
    sample = strict.value(values, "sample", Count)
    check_name("study", study)
    if files:
        source = read(Path(files[0]))
    elif settings.cams or flavour == "text":
        source = find(settings.cams, flavour, study, results, recording, sample)
    else:
        raise ValueError("name a file, or the cameras whose program it is: cams=[…]")
    source = scaled(source, values["unit"], "unit")
    try:
        program = compile_program(source.text)
    except ProgramError as error:
        where = {"line": error.line, "column": error.column, "reason": error.reason}
        refused = {"passed": False, "origin": source.origin, "refused": where}
        print(json.dumps(refused) if options.json else f"{source.origin}: {error}")
        return 1
    from needlehoop.vlm.card import card

    found = card(program, settings, gates)
    if options.json:
        print(json.dumps({"origin": source.origin, **found.as_dict()}))
    else:
        print(f"program      {source.origin}\n{found}")
    return 0 if found.passed else 1
