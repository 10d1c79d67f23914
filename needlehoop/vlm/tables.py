"""A model's answers and what they cost, as tables."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from scipy.stats import rankdata

from needlehoop.rewards.written import FIRST
from needlehoop.runs.files import csv_text
from needlehoop.runs.shipped import RECORDINGS
from needlehoop.study.data.answers import as_rows
from needlehoop.study.render.table import Column, Table
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.record import Exchange

_SENT_BACK = fill("again", reason="\n").partition("\n")[0]
"""How a message begins that sends an answer back."""


def questions_csv(answers: Mapping[str, Any], asked: Mapping[str, str]) -> str:
    """``question``, ``answer``, ``reason``: the rows of the paper's Table I, and Appendix B's.

    ``asked`` as in ``as_rows``.
    """
    rows = [(row.question, row.answer, row.reason) for row in as_rows(answers, asked)]
    return csv_text(("question", "answer", "reason"), rows)


def rankings_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``sample``, ``place`` (all from 1), ``cameras``, ``sure``, ``reason``.

    ``sure``: the stated probability that the set is better than the next; empty for the last.
    """
    rows = [
        (number, sample, place, entry["name"], sure, entry["reason"])
        for number, ranked in enumerate(lists, 1)
        for sample, (places, own) in enumerate(
            zip(ranked["rankings"], ranked["sure"], strict=True), 1
        )
        for place, (entry, sure) in enumerate(zip(places, (*own, ""), strict=True), 1)
    ]
    return csv_text(("list", "sample", "place", "cameras", "sure", "reason"), rows)


def agreement_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``samples``, ``tau_b``, ``same_top``; empty cells where there is one sample."""
    rows = []
    for number, ranked in enumerate(lists, 1):
        agreed = ranked["agreement"] or {"tau_b": "", "same_top": ""}
        rows.append((number, len(ranked["rankings"]), agreed["tau_b"], agreed["same_top"]))
    return csv_text(("list", "samples", "tau_b", "same_top"), rows)


def totals_csv(found: Mapping[str, Mapping[str, int]]) -> str:
    """``conversation`` and its totals, one row each; the last row, ``all``, is their sum."""
    head = ("conversation", *found["all"])
    return csv_text(head, [(name, *row.values()) for name, row in found.items()])


def totals_of(exchanges: Iterable[Exchange]) -> dict[str, dict[str, int]]:
    """Prompts and tokens by conversation, then of all of them as ``all``.

    A request without a reply is not a prompt. Tokens that were not reported count nothing. An
    answer is invalid if it was cut off, refused, empty or sent back. The last attempt at a
    question is never sent back, so it does not show that it was invalid.
    """
    asked = [e for e in exchanges if e.outcome != "failed"]
    sent_back = {
        _key(messages[:-2], messages[-2])
        for messages in (e.request["messages"] for e in asked)
        if len(messages) > 2 and messages[-1]["parts"][0].get("text", "").startswith(_SENT_BACK)
    }

    def invalid(exchange: Exchange) -> bool:
        answer = {"role": "assistant", "parts": [{"text": exchange.answer}]}
        key = _key(exchange.request["messages"], answer)
        return exchange.outcome != "answered" or key in sent_back

    def of(chosen: list[Exchange]) -> dict[str, int]:
        counts = [(e.tokens_in, e.tokens_out) for e in chosen]
        return {
            "prompts": len(chosen),
            "tokens_in": sum(tokens or 0 for tokens, _ in counts),
            "tokens_out": sum(tokens or 0 for _, tokens in counts),
            "prompts_without_token_count": sum(None in both for both in counts),
            "invalid_answers": sum(map(invalid, chosen)),
        }

    names = dict.fromkeys(exchange.conversation for exchange in asked)
    rows = {name: of([e for e in asked if e.conversation == name]) for name in names}
    return {**rows, "all": of(asked)}


def in_words(found: Mapping[str, int]) -> str:
    """Totals in a line."""
    tokens = found["tokens_in"] + found["tokens_out"]
    unknown = found["prompts_without_token_count"]
    return (
        f"{found['prompts']} prompts, {tokens} tokens ({found['tokens_in']} in,"
        f" {found['tokens_out']} out{f'; {unknown} prompts not counted' if unknown else ''}),"
        f" {found['invalid_answers']} invalid answers"
    )


def papers_totals() -> str:
    """The paper's totals in words; it does not say how many answers were invalid."""
    with (RECORDINGS / "paper" / "totals.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    return f"{row['prompts']} prompts, {row['tokens']} tokens"


class Accepted(NamedTuple):
    """A program's figures at the gates, and its values at the recorded moments."""

    card: Mapping[str, Any]
    values: Sequence[float]


def compared(name: str, programs: Mapping[int, Accepted]) -> Table:
    """How several programs for the same cameras differ: one row each.

    Args:
        name: of the table's file.
        programs: by the number of the sample.
    """
    # A task without a cheat has no such figure.
    figures = [own.card for own in programs.values()]
    others = [to for to in ("random", "cheat") if figures[0][to] is not None]
    rows = [
        (
            number,
            *(own.card["expert"] - own.card[to] for to in others),
            own.card["paid"],
            *(_rho(own.values, other.values) for other in programs.values()),
        )
        for number, own in programs.items()
    ]
    columns = (
        Column("sample"),
        *(Column(f"expert - {to}", form=".3f") for to in others),
        Column("paid", "%", ".1f", 100.0),
        *(Column(f"rho with {number}", form=".3f") for number in programs),
    )
    note = (
        "rho: Spearman's, of the values over the recorded trajectories. Trained on: sample"
        f" {FIRST}, or that of reward.sample=."
    )
    return Table(name, "Samples compared", columns, tuple(rows), note)


def _rho(a: Sequence[float], b: Sequence[float]) -> float | None:
    """Spearman's rank correlation; ``None`` where one side is constant."""
    x, y = (rankdata(side) - (len(side) + 1) / 2 for side in (a, b))
    size = math.sqrt(float((x**2).sum() * (y**2).sum()))
    return float((x * y).sum()) / size if size else None


def _key(messages: Sequence[Any], answer: Any) -> str:
    return repr([*messages, answer])
