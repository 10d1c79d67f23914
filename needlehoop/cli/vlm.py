"""``needlehoop vlm question``, ``rank``, ``reward`` and ``check``."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import add_command
from needlehoop.runs.reading import printable

if TYPE_CHECKING:
    from needlehoop.vlm.inquiry import Inquiry

_SHARED = (
    "vlm=replay|gemini|openai|manual vlm.told=full|names|nothing study=main overwrite=false"
    " attempts=3 size=384 vlm.recording=claude"
)

_PROGRAM = "FILE, flavour, study, recording, sample, unit"
"""The words of ``check`` that choose the program."""

_STOPPED = 130
"""Exit status of a command that Ctrl-C stopped."""


def add_commands(commands: Any) -> None:
    """Add ``vlm`` and its commands to the subparsers of ``needlehoop``."""
    summary = "Ask a vision-language model about cameras and rewards; check reward programs."
    parser = commands.add_parser("vlm", help=summary, description=summary)
    below = parser.add_subparsers(dest="action", required=True)

    def add(name: str, run: Callable[[argparse.Namespace], None], summary: str, keys: str) -> None:
        add_command(below, name, partial(_stoppable, run), summary, keys)

    summary = "Ask which views and renderings suit the task's parts."
    add("question", _question, summary, f"shown=[rgb,dep,seg] {_SHARED}")
    summary = "Ask for rankings of camera sets."
    own = (
        "lists=[[rgb_default,dep_front+seg_side]] samples=1 afresh=false sets=[rgb_front,…]"
        " words=true group=5 rounds=4 pictures=FOLDER about=…"
    )
    add("rank", _rank, summary, f"{own} {_SHARED}")
    summary = "Ask for a reward program for a camera set."
    own = (
        "cams=[dep_front,seg_side]|[…],[…]|all flavour=image|text samples=1 revise=RUN"
        " gates.margin=2"
    )
    add("reward", _reward, summary, f"{own} {_SHARED}")
    summary = "Compile a reward program, put it through the gates, print its card."
    check = below.add_parser(
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


def _stoppable(
    run: Callable[[argparse.Namespace], None], options: argparse.Namespace
) -> int | None:
    """Ctrl-C ends a command without loss: all answers so far are recorded."""
    try:
        return run(options)
    except KeyboardInterrupt:
        print("needlehoop vlm: stopped; the same command goes on", file=sys.stderr)
        return _STOPPED


def _question(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict

    values = composing.compose(options.overrides, "vlm_question")
    from needlehoop.vlm.questions import Questions

    questions = strict.as_type(values, Questions)
    with _open(values) as inquiry:
        found = inquiry.question(questions)
    answers = found["answers"]
    for part in ("first", "second"):
        suits, subtask = answers["suits"][part], answers["subtasks"][part]
        said = f"{part} subtask: {subtask['name']}; {suits['rendering']}, {suits['view']} view"
        print(printable(said))
    for what, shown in answers.items():
        if "rendering" in shown:
            print(f"{what}: best shown by {shown['rendering']}, {shown['view']} view")
    print(f"layouts: {' > '.join(entry['name'] for entry in answers['layouts'])}")
    _report(inquiry, "questions.csv")


def _rank(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict

    values = composing.compose(options.overrides, "vlm_rank")
    from needlehoop.study.data.sweeps import planned
    from needlehoop.vlm.album import read_folder
    from needlehoop.vlm.questions import Lists, Questions

    chosen = [word.lstrip("+") for word in options.overrides if word.startswith("+experiment=")]
    if chosen:
        # One picture against two is no question.
        named = dict.fromkeys(place.cameras for place in planned(chosen))
        counts = sorted({name.count("+") for name in named})
        values["sets"] = [[name for name in named if name.count("+") == n] for n in counts]
    elif any(isinstance(one, str) for one in values["sets"] or ()):
        values["sets"] = [values["sets"]]
    folder, about = (strict.value(values, key, str | None) for key in ("pictures", "about"))
    questions, lists = strict.as_type(values, Questions), strict.as_type(values, Lists)
    bench = None if folder is None else read_folder(Path(folder), about, values["size"])
    with _open(values) as inquiry:
        if bench is None:
            found, how = inquiry.rank(questions, lists), inquiry.ranked(lists)
        else:
            found, how = inquiry.rank_pictures(*bench, lists), "_pictures"
    for number, entry in enumerate(found["lists"], 1):
        for places in entry["rankings"]:
            print(f"list {number}: {' > '.join(place['name'] for place in places)}")
        if entry["agreement"]:
            agreed = entry["agreement"]
            print(f"  tau_b {agreed['tau_b']:.3f}, same top {agreed['same_top']:.2f}")
    _report(inquiry, f"rankings{how}.csv", f"agreement{how}.csv")


def _reward(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict
    from needlehoop.vlm.config import Gates, Samples

    # All camera sets are checked before the first is asked for.
    several = [composing.compose(words, "vlm_reward") for words in _sets(options.overrides)]
    flavour = strict.value(several[0], "flavour", str)
    samples = strict.value(several[0], "samples", Samples)
    revised = strict.value(several[0], "revise", str | None)
    for values in several:
        strict.as_type(values["gates"], Gates, "gates")
        _understood(values)
    from needlehoop.training.missing_reward import rules_of
    from needlehoop.vlm.conversation import NoAnswerError
    from needlehoop.vlm.record import RefusalError
    from needlehoop.vlm.writing import read_run

    if revised is not None and (samples > 1 or len(several) > 1):
        raise ValueError("revise: one run for one camera set and one sample")
    trained = None if revised is None else read_run(Path(revised), several[0]["size"])
    rules, failed = None, []
    for values in several:
        with _open(values) as inquiry:
            if len(several) > 1:
                print("+".join(values["cams"]))
                if inquiry.has_rewards(flavour, samples) and not values["overwrite"]:
                    print("  is there already")
                    continue
            # The trajectories that programs are judged by do not depend on the cameras.
            rules = rules or rules_of(values)
            try:
                paths, comparison = inquiry.reward(flavour, rules, samples, trained)
            except (NoAnswerError, RefusalError) as error:
                if len(several) == 1:
                    raise
                print(f"  {error}", file=sys.stderr)
                failed.append("+".join(values["cams"]))
                continue
        if comparison is not None:
            print(comparison.text())
        _report(inquiry, *(path.relative_to(inquiry.folder) for path in paths))
    if failed:
        raise NoAnswerError(
            f"{len(failed)} of {len(several)} sets have no program: {', '.join(failed)}; the same"
            " command asks for what is missing"
        )


def _sets(words: list[str]) -> list[list[str]]:
    """A command line for each camera set; ``cams=all`` and ``cams=[…],[…]`` give several.

    ``all`` stands for the paper's camera sets, those of ``+experiment=table2``.
    """
    from needlehoop.study.data import paper

    given = next((word for word in words if word.startswith("cams=")), "")
    value = given.removeprefix("cams=")
    sets = [f"[{name.replace('+', ',')}]" for name in paper.measured()]
    if value != "all":
        sets = re.findall(r"\[[^\[\]]*\]", value)
        if len(sets) < 2 or ",".join(sets) != value:
            return [words]
    return [[f"cams={one}" if word == given else word for word in words] for one in sets]


def _understood(values: dict[str, Any]) -> tuple[Any, Any, Any]:
    """The scene, the inquiry's settings and the provider's, checked."""
    from needlehoop.config import strict
    from needlehoop.training.options import provider_config
    from needlehoop.vlm.config import InquiryConfig

    asked, provider = strict.as_type(values, InquiryConfig), provider_config(values["vlm"])
    from needlehoop.envs.settings import settings_from

    return settings_from(values), asked, provider


def _open(values: dict[str, Any]) -> Inquiry:
    understood = _understood(values)
    from needlehoop.vlm.inquiry import Inquiry

    inquiry = Inquiry(*understood)
    if inquiry.record.torn is not None:
        print(f"needlehoop vlm: {inquiry.record.torn}", file=sys.stderr)
    return inquiry


def _report(inquiry: Inquiry, *written: str | Path) -> None:
    """Print where the answers are, what they cost, and what the whole transcript cost."""
    from needlehoop.vlm.conversation import in_words, papers_totals

    for name in written:
        print(inquiry.folder / name)
    print(f"this:       {in_words(inquiry.spent())}")
    print(f"transcript: {in_words(inquiry.totals()['all'])}")
    print(f"the paper:  {papers_totals()}")


def _check(options: argparse.Namespace) -> int:
    from needlehoop.config import composing, strict
    from needlehoop.config.strict import Count, Positive
    from needlehoop.rewards.language.grammar import ProgramError
    from needlehoop.rewards.language.program import compile_program
    from needlehoop.rewards.written import find, read, scaled
    from needlehoop.runs.files import check_name
    from needlehoop.vlm.config import Gates

    files = [word for word in options.overrides if "=" not in word]
    if len(files) > 1:
        raise ValueError(f"one file at a time; got {' '.join(files)}")
    words = [word for word in options.overrides if "=" in word]
    for word in words:
        if re.match(r"reward\b", word):
            raise ValueError(
                f"{word}: the program is judged, no other reward; choose from its {_PROGRAM}"
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
    source = scaled(source, strict.value(values, "unit", Positive | None), "unit")
    try:
        program = compile_program(source.text, settings.definition.signals)
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
