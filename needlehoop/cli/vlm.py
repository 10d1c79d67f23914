"""``needlehoop vlm question``, ``rank``, ``reward`` and ``check``."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import JSON, KEYS, argument, command, environment
from needlehoop.config import composing, strict
from needlehoop.config.options import typed
from needlehoop.config.strict import Count, Positive
from needlehoop.runs.files import check_name
from needlehoop.runs.reading import printable

if TYPE_CHECKING:
    from needlehoop.vlm.inquiry import Inquiry

SUMMARY = "Ask a vision-language model about cameras and rewards; check reward programs."


@command(KEYS, config="vlm_question")
def vlm_question(options: argparse.Namespace) -> None:
    """Ask which views and renderings suit the task's parts."""
    values = composing.compose(options.overrides, "vlm_question")
    from needlehoop.study.data.answers import as_rows
    from needlehoop.vlm.questions import Questions

    questions = strict.as_type(values, Questions)
    with _open(values) as inquiry:
        result = inquiry.question(questions)
    for row in as_rows(result["answers"], result["asked"]):
        print(printable(f"{row.question}: {row.answer}"))
    _report(inquiry, "questions.csv")


@command(KEYS, config="vlm_rank")
def vlm_rank(options: argparse.Namespace) -> None:
    """Ask for rankings of camera sets."""
    named, words = [], options.overrides
    for experiment in typed(words, "experiment"):
        from needlehoop.training.sweep import camera_sets

        named = camera_sets(experiment)
        # Typed, so that all their views are among the settings.
        words = [*words, f"sets=[{','.join(named)}]"]
    values = composing.compose(words, "vlm_rank")
    from needlehoop.vlm.album import read_folder
    from needlehoop.vlm.questions import Lists, Questions

    if named:
        # One picture against two is no question.
        counts = sorted({name.count("+") for name in named})
        values["sets"] = [[name for name in named if name.count("+") == n] for n in counts]
    elif any(isinstance(name, str) for name in values["sets"] or ()):
        values["sets"] = [values["sets"]]
    folder, about = (strict.value(values, key, str | None) for key in ("pictures", "about"))
    questions, lists = strict.as_type(values, Questions), strict.as_type(values, Lists)
    bench = None if folder is None else read_folder(Path(folder), about, values["size"])
    with _open(values) as inquiry:
        if bench is None:
            result, how = inquiry.rank(questions, lists), inquiry.suffix(lists)
        else:
            result, how = inquiry.rank_pictures(*bench, lists), "_pictures"
    for number, entry in enumerate(result["lists"], 1):
        for places in entry["rankings"]:
            print(f"list {number}: {' > '.join(place['name'] for place in places)}")
        if entry["agreement"]:
            agreed = entry["agreement"]
            print(f"  tau_b {agreed['tau_b']:.3f}, same top {agreed['same_top']:.2f}")
    _report(inquiry, f"rankings{how}.csv", f"agreement{how}.csv")


@command(KEYS, config="vlm_reward")
def vlm_reward(options: argparse.Namespace) -> None:
    """Ask for a reward program for a camera set.

    cams=[…],[…] asks for one for each of several sets, cams=all for each of the paper's.
    """
    from needlehoop.vlm.config import Gates, Samples

    # All camera sets are checked before the first is asked for.
    several = [composing.compose(words, "vlm_reward") for words in _sets(options.overrides)]
    from needlehoop.rewards.program_reward import Flavour

    keys = strict.read(several[0], flavour=Flavour, samples=Samples, revise=str | None)
    for values in several:
        strict.value(values, "gates", Gates)
        _open(values)
    from needlehoop.training.session import rules_of
    from needlehoop.vlm.conversation import NoAnswerError
    from needlehoop.vlm.record import RefusalError
    from needlehoop.vlm.writing import read_run

    if keys.revise is not None and (keys.samples > 1 or len(several) > 1):
        raise ValueError("revise: one run for one camera set and one sample")
    trained = None if keys.revise is None else read_run(Path(keys.revise), several[0]["size"])
    failed = []
    for values in several:
        with _open(values) as inquiry:
            if len(several) > 1:
                print("+".join(values["cams"]))
                if inquiry.has_rewards(keys.flavour, keys.samples) and not values["overwrite"]:
                    print("  is there already")
                    continue
            try:
                paths = inquiry.reward(keys.flavour, rules_of(values), keys.samples, trained)
            except (NoAnswerError, RefusalError) as error:
                if len(several) == 1:
                    raise
                print(f"  {error}", file=sys.stderr)
                failed.append("+".join(values["cams"]))
                continue
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

    value = ",".join(typed(words, "cams"))
    sets = re.findall(r"\[[^\[\]]*\]", value)
    if value == "all":
        sets = [f"[{name.replace('+', ',')}]" for name in paper.measured()]
    if len(sets) < 2:
        return [words]
    rest = [word for word in words if not word.startswith("cams=")]
    return [[*rest, f"cams={cams}"] for cams in sets]


def _open(values: dict[str, Any]) -> Inquiry:
    from needlehoop.training.session import provider_config
    from needlehoop.vlm.config import InquiryConfig

    config, provider = strict.as_type(values, InquiryConfig), provider_config(values["vlm"])
    from needlehoop.envs.settings import settings_from

    settings = settings_from(values)
    # What is wrong is said before all that answers needs is imported.
    from needlehoop.vlm.inquiry import Inquiry

    return Inquiry(settings, config, provider)


def _report(inquiry: Inquiry, *written: str | Path) -> None:
    """Print where the answers are, what they cost, and what the whole transcript cost."""
    from needlehoop.study.data import paper
    from needlehoop.vlm.conversation import in_words, totals_of

    for name in written:
        print(inquiry.folder / name)
    print(f"this:       {in_words(totals_of(inquiry.record.used)['all'])}")
    print(f"transcript: {in_words(totals_of(inquiry.record.exchanges)['all'])}")
    # The paper does not say how many answers were invalid.
    (papers,) = paper.rows("totals.csv")
    print(f"the paper:  {papers['prompts']} prompts, {papers['tokens']} tokens")


@command(argument("overrides", nargs="*", metavar="FILE | key=value"), JSON, config="check")
def vlm_check(options: argparse.Namespace) -> int:
    """Compile a reward program, put it through the gates, print the report.

    Exit status 1 where it is refused.
    """
    from needlehoop.rewards.language.program import ProgramError, compile_program
    from needlehoop.rewards.program_reward import Flavour, find, read, scaled
    from needlehoop.vlm.config import Gates

    files = [word for word in options.overrides if "=" not in word]
    options.overrides = [word for word in options.overrides if "=" in word]
    place: dict[str, Any] = {"study": str, "results": str, "recording": str | None, "sample": Count}
    settings, keys = environment(
        options, "check", gates=Gates, flavour=Flavour, unit=Positive | None, **place
    )
    check_name("study", keys.study)
    if files:
        source = read(Path(files[0]))
    elif settings.cams or keys.flavour == "text":
        source = find(
            settings.cams, keys.flavour, keys.study, keys.results, keys.recording, keys.sample
        )
    else:
        raise ValueError("name a file, or the cameras whose program it is: cams=[…]")
    source = scaled(source, keys.unit, "unit")
    try:
        program = compile_program(source.text, settings.definition.signals)
    except ProgramError as error:
        where = {"line": error.line, "column": error.column, "reason": error.reason}
        refused = {"passed": False, "origin": source.origin, "refused": where}
        print(json.dumps(refused) if options.json else f"{source.origin}: {error}")
        return 1
    from needlehoop.vlm.gate_report import gate_report

    report = gate_report(program, settings, keys.gates)
    if options.json:
        print(json.dumps({"origin": source.origin, **report.as_dict()}))
    else:
        print(f"program      {source.origin}\n{report}")
    return 0 if report.passed else 1
