"""``needlehoop vlm question``, ``rank`` and ``reward``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from needlehoop.vlm.inquiry import Inquiry
    from needlehoop.vlm.writing import Workshop

_SHARED = "vlm=replay|gemini|openai study=main overwrite=false attempts=3 size=384 vlm.recording=…"


def add_ask_commands(commands: Any, workshop: Callable[[dict[str, Any]], Workshop]) -> None:
    """Add the commands that ask.

    Args:
        commands: the subparsers of ``needlehoop vlm``.
        workshop: the language of rewards and its judge, for a composed config.
    """

    def add(
        name: str, run: Callable[[argparse.Namespace], None], summary: str, keys: str = ""
    ) -> None:
        command = commands.add_parser(
            name,
            help=summary,
            description=summary,
            epilog=f"Keys: {keys}{_SHARED}; and all of conf/env.yaml, such as task=wide.",
        )
        command.add_argument("overrides", nargs="*", metavar="key=value")
        command.set_defaults(run=run)

    add("question", _question, "Ask which views and renderings suit the task's parts.")
    add(
        "rank",
        _rank,
        "Ask for rankings of sets of cameras.",
        "lists=[[rgb_default,dep_front+seg_side]] samples=1 ",
    )

    def reward(options: argparse.Namespace) -> None:
        _reward(options, workshop)

    add(
        "reward",
        reward,
        "Ask for a reward program for a set of cameras.",
        "cams=[dep_front,seg_side] flavour=image|text ",
    )


def _question(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.vlm.questions import Questions

    values = config.compose(options.overrides, "vlm_question")
    questions = config.as_type(values, Questions)
    with _open(values) as inquiry:
        found = inquiry.question(questions)
    answers = found["answers"]
    for part in ("first", "second"):
        suits, subtask = answers["suits"][part], answers["subtasks"][part]
        print(f"{part} subtask: {subtask['name']}; {suits['rendering']}, {suits['view']} view")
    for what in ("goal", "lifted"):
        print(f"{what}: best shown by {answers[what]['rendering']}, {answers[what]['view']} view")
    print(f"layouts: {' > '.join(entry['name'] for entry in answers['layouts'])}")
    _report(found["totals"])


def _rank(options: argparse.Namespace) -> None:
    from needlehoop import config
    from needlehoop.vlm.questions import Questions
    from needlehoop.vlm.ranking import Lists

    values = config.compose(options.overrides, "vlm_rank")
    questions, lists = config.as_type(values, Questions), config.as_type(values, Lists)
    with _open(values) as inquiry:
        found = inquiry.rank(questions, lists)
    for number, entry in enumerate(found["lists"], 1):
        for places in entry["rankings"]:
            print(f"list {number}: {' > '.join(place['name'] for place in places)}")
        if entry["agreement"]:
            agreed = entry["agreement"]
            print(f"  tau_b {agreed['tau_b']:.3f}, same top {agreed['same_top']:.2f}")
    _report(found["totals"])


def _reward(options: argparse.Namespace, workshop: Callable[[dict[str, Any]], Workshop]) -> None:
    from needlehoop import config

    values = config.compose(options.overrides, "vlm_reward")
    with _open(values) as inquiry:
        path, totals = inquiry.reward(values["flavour"], workshop(values))
    print(path)
    _report(totals)


def _open(values: dict[str, Any]) -> Inquiry:
    from needlehoop import config
    from needlehoop.vlm.inquiry import Inquiry, InquiryConfig
    from needlehoop.vlm.provider import LiveConfig, ReplayConfig

    kind = ReplayConfig if values["vlm"]["kind"] == "replay" else LiveConfig
    inquiry = Inquiry(
        config.structure(values),
        config.as_type(values, InquiryConfig),
        config.as_type(values["vlm"], kind, "vlm"),
    )
    if inquiry.transcript.torn is not None:
        print(f"needlehoop vlm: {inquiry.transcript.torn}", file=sys.stderr)
    return inquiry


def _report(totals: dict[str, int]) -> None:
    tokens = totals["tokens_in"] + totals["tokens_out"]
    print(
        f"{totals['prompts']} prompts, {tokens} tokens ({totals['tokens_in']} in,"
        f" {totals['tokens_out']} out), {totals['invalid_answers']} invalid answers"
    )
