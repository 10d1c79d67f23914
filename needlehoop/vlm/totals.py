"""What asking a model cost: prompts, tokens, and answers that were of no use."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from typing import Any

from needlehoop.runs.shipped import RECORDINGS
from needlehoop.vlm.prompts import fill
from needlehoop.vlm.transcript import Exchange

_SENT_BACK = fill("again", reason="\n").partition("\n")[0]
"""How a message begins that sends an answer back."""


def totals(exchanges: Sequence[Exchange], invalid: int) -> dict[str, int]:
    """The sums over exchanges; tokens that were not reported count nothing.

    Args:
        exchanges: that reached a model.
        invalid: how many of their answers could not be used.
    """
    return {
        "prompts": len(exchanges),
        "tokens_in": sum(e.tokens_in or 0 for e in exchanges),
        "tokens_out": sum(e.tokens_out or 0 for e in exchanges),
        "prompts_without_token_count": sum(
            e.tokens_in is None or e.tokens_out is None for e in exchanges
        ),
        "invalid_answers": invalid,
    }


def of_transcript(exchanges: Iterable[Exchange]) -> dict[str, dict[str, int]]:
    """Totals by conversation, then of all of them as ``all``.

    Requests that brought no reply are not prompts. An answer was invalid if it was cut off,
    refused or empty, or if it was sent back; one that was the last of its question's attempts
    shows nowhere in a transcript, only in the totals of the command that gave up.
    """
    asked = [e for e in exchanges if e.outcome != "failed"]
    sent_back = {
        _key(messages[:-2], messages[-2])
        for messages in (e.request["messages"] for e in asked)
        if len(messages) > 2 and messages[-1]["parts"][0].get("text", "").startswith(_SENT_BACK)
    }

    def invalid(exchange: Exchange) -> bool:
        answer = {"role": "assistant", "parts": [{"text": exchange.answer}]}
        said = _key(exchange.request["messages"], answer)
        return exchange.outcome != "answered" or said in sent_back

    def of(chosen: list[Exchange]) -> dict[str, int]:
        return totals(chosen, sum(map(invalid, chosen)))

    names = dict.fromkeys(exchange.conversation for exchange in asked)
    rows = {name: of([e for e in asked if e.conversation == name]) for name in names}
    return {**rows, "all": of(asked)}


def in_words(found: dict[str, int]) -> str:
    """Totals in a line."""
    tokens = found["tokens_in"] + found["tokens_out"]
    unknown = found["prompts_without_token_count"]
    return (
        f"{found['prompts']} prompts, {tokens} tokens ({found['tokens_in']} in,"
        f" {found['tokens_out']} out{f'; {unknown} prompts not counted' if unknown else ''}),"
        f" {found['invalid_answers']} invalid answers"
    )


def papers() -> str:
    """The paper's totals in words; it does not say how many answers were invalid."""
    with (RECORDINGS / "paper" / "totals.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    return f"{row['prompts']} prompts, {row['tokens']} tokens"


def _key(messages: Sequence[Any], answer: Any) -> str:
    return repr([*messages, answer])
