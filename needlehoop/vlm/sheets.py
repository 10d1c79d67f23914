"""A model's answers as tables, for those who would rather not read JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from needlehoop.runs.files import csv_text
from needlehoop.study.data.answers import as_rows


def questions(answers: Mapping[str, Any]) -> str:
    """``question``, ``answer``, ``reason``: the rows of the paper's Table I, and Appendix B's."""
    rows = [(row.question, row.answer, row.reason) for row in as_rows(answers)]
    return csv_text(("question", "answer", "reason"), rows)


def rankings(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``sample``, ``place``, ``cameras``, ``reason``; all count from 1."""
    rows = [
        (number, sample, place, entry["name"], entry["reason"])
        for number, ranked in enumerate(lists, 1)
        for sample, places in enumerate(ranked["rankings"], 1)
        for place, entry in enumerate(places, 1)
    ]
    return csv_text(("list", "sample", "place", "cameras", "reason"), rows)


def agreement(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``samples``, ``tau_b``, ``same_top``; empty cells where there is one sample."""
    rows = []
    for number, ranked in enumerate(lists, 1):
        agreed = ranked["agreement"] or {"tau_b": "", "same_top": ""}
        rows.append((number, len(ranked["rankings"]), agreed["tau_b"], agreed["same_top"]))
    return csv_text(("list", "samples", "tau_b", "same_top"), rows)


def totals(found: Mapping[str, Mapping[str, int]]) -> str:
    """``conversation`` and what it cost, one row each; the last, ``all``, is their sum."""
    head = ("conversation", *found["all"])
    return csv_text(head, [(name, *row.values()) for name, row in found.items()])
