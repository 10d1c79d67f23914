"""``needlehoop vlm question``, ``rank`` and ``reward``."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlehoop.cli.command import add_command
from needlehoop.runs.terminal import printable

if TYPE_CHECKING:
    from needlehoop.vlm.inquiry import Inquiry

_SHARED = (
    "vlm=replay|gemini|openai|manual study=main overwrite=false attempts=3 size=384 vlm.recording=…"
)


_STOPPED = 130
"""Exit status of a command that Ctrl-C stopped."""


def add_ask_commands(commands: Any) -> None:
    """Add the commands that ask to the subparsers of ``needlehoop vlm``."""

    def add(name: str, run: Callable[[argparse.Namespace], None], summary: str, keys: str) -> None:
        add_command(commands, name, partial(_stoppable, run), summary, keys)

    summary = "Ask which views and renderings suit the task's parts."
    add("question", _question, summary, f"shown=[rgb,dep,seg] {_SHARED}")
    summary = "Ask for rankings of sets of cameras."
    own = "lists=[[rgb_default,dep_front+seg_side]] samples=1"
    add("rank", _rank, summary, f"{own} {_SHARED}")
    summary = "Ask for a reward program for a set of cameras."
    own = "cams=[dep_front,seg_side]|[…],[…]|all flavour=image|text samples=1 gates.margin=2"
    add("reward", _reward, summary, f"{own} {_SHARED}")


def _stoppable(
    run: Callable[[argparse.Namespace], None], options: argparse.Namespace
) -> int | None:
    """Ctrl-C loses nothing: what was answered is recorded."""
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
    for what in ("goal", "lifted"):
        print(f"{what}: best shown by {answers[what]['rendering']}, {answers[what]['view']} view")
    print(f"layouts: {' > '.join(entry['name'] for entry in answers['layouts'])}")
    _report(inquiry, found["totals"], "questions.csv")


def _rank(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict

    values = composing.compose(options.overrides, "vlm_rank")
    from needlehoop.vlm.questions import Questions
    from needlehoop.vlm.ranking import Lists

    questions, lists = strict.as_type(values, Questions), strict.as_type(values, Lists)
    with _open(values) as inquiry:
        found = inquiry.rank(questions, lists)
    for number, entry in enumerate(found["lists"], 1):
        for places in entry["rankings"]:
            print(f"list {number}: {' > '.join(place['name'] for place in places)}")
        if entry["agreement"]:
            agreed = entry["agreement"]
            print(f"  tau_b {agreed['tau_b']:.3f}, same top {agreed['same_top']:.2f}")
    _report(inquiry, found["totals"], "rankings.csv", "agreement.csv")


def _reward(options: argparse.Namespace) -> None:
    from needlehoop.config import composing, strict
    from needlehoop.vlm.asked import Samples
    from needlehoop.vlm.gates import Gates

    # Every set is checked before any is asked for.
    several = [composing.compose(words, "vlm_reward") for words in _sets(options.overrides)]
    flavour = strict.value(several[0], "flavour", str)
    samples = strict.value(several[0], "samples", Samples)
    for values in several:
        strict.as_type(values["gates"], Gates, "gates")
        _understood(values)
    from needlehoop.training.missing_reward import workshop
    from needlehoop.vlm.conversation import NoAnswerError
    from needlehoop.vlm.recorder import RefusalError

    shop, failed = None, []
    for values in several:
        with _open(values) as inquiry:
            if len(several) > 1:
                print("+".join(values["cams"]))
                if inquiry.has_rewards(flavour, samples) and not values["overwrite"]:
                    print("  is there already")
                    continue
            # The trajectories that programs are judged by are the same for all cameras.
            shop = shop or workshop(values)
            try:
                found = inquiry.reward(flavour, shop, samples)
            except (NoAnswerError, RefusalError) as error:
                if len(several) == 1:
                    raise
                print(f"  {error}", file=sys.stderr)
                failed.append("+".join(values["cams"]))
                continue
        if found.comparison is not None:
            print(found.comparison.text())
        _report(inquiry, found.totals, *(path.relative_to(inquiry.folder) for path in found.paths))
    if failed:
        raise NoAnswerError(
            f"{len(failed)} of {len(several)} sets have no program: {', '.join(failed)}; the same"
            " command asks for what is missing"
        )


def _sets(words: list[str]) -> list[list[str]]:
    """A command line for each set of cameras: ``cams=all`` or ``cams=[…],[…]`` are several.

    ``all`` are the paper's, those of ``+experiment=table2``.
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
    """Scene, asking and who answers, checked."""
    from needlehoop.config import strict
    from needlehoop.training.options import provider_config
    from needlehoop.vlm.asked import InquiryConfig

    asked, provider = strict.as_type(values, InquiryConfig), provider_config(values["vlm"])
    from needlehoop.envs.settings import settings_from

    return settings_from(values), asked, provider


def _open(values: dict[str, Any]) -> Inquiry:
    understood = _understood(values)
    from needlehoop.vlm.inquiry import Inquiry

    inquiry = Inquiry(*understood)
    if inquiry.transcript.torn is not None:
        print(f"needlehoop vlm: {inquiry.transcript.torn}", file=sys.stderr)
    return inquiry


def _report(inquiry: Inquiry, found: dict[str, int], *written: str | Path) -> None:
    """Where the answers are, and what they, and all of the transcript, cost."""
    from needlehoop.vlm.totals import in_words, papers

    for name in written:
        print(inquiry.folder / name)
    print(f"this:       {in_words(found)}")
    print(f"transcript: {in_words(inquiry.totals()['all'])}")
    print(f"the paper:  {papers()}")
