"""A reward program's figures at the gates, and whether it passes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import torch
from pydantic import TypeAdapter
from torch import Tensor

from needlehoop.envs.settings import Settings
from needlehoop.rewards import potential
from needlehoop.rewards.language.program import Program
from needlehoop.scene.signals import Signals
from needlehoop.vlm.config import Gates
from needlehoop.vlm.moments import CHEAT, collect, random_signals


@dataclass(frozen=True)
class GateReport:
    """A program's figures, and why it was refused or flagged.

    ``lowest`` and ``highest`` are its values over the recorded moments, before clipping;
    ``random_lowest`` and ``random_highest`` those over the random signals. ``expert``, ``random``
    and ``cheat`` (``None``: the task has none) are mean final values of the controllers, clipped
    if the gates say so. ``paid``: share of a random policy's steps that change the value.
    ``stopped``: how far each way of stopping short ends below finishing.
    """

    terms: tuple[str, ...]
    not_finite_random: int
    not_finite_recorded: int
    random_signals: int
    recorded_moments: int
    lowest: float
    highest: float
    random_lowest: float
    random_highest: float
    expert: float
    random: float
    cheat: float | None
    paid: float
    stopped: Mapping[str, float]
    gates: Gates
    reasons: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether no gate refuses the program. Flags do not refuse."""
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values for JSON; a figure that is not finite is ``None``."""
        return {"passed": self.passed, **json.loads(TypeAdapter(GateReport).dump_json(self))}

    def __str__(self) -> str:
        g, above = self.gates, self.expert - self.random
        lines = [
            f"terms        {', '.join(self.terms)}",
            f"not finite   {self.not_finite_random} of {self.random_signals} random signals,"
            f" {self.not_finite_recorded} of {self.recorded_moments} recorded moments",
            f"range        {self.lowest:.3f} to {self.highest:.3f} recorded"
            f" ({self.random_lowest:.3g} to {self.random_highest:.3g} on random signals);"
            f" allowed {g.low:g} to {g.high:g} + {g.bonus:g}, {g.range}",
            f"expert       {self.expert:.3f} at the end",
            f"random       {self.random:.3f}; the expert is {above:.3f} above, at least"
            f" {g.margin:g} is asked",
        ]
        if self.cheat is not None:
            lines.append(
                f"cheat        {self.cheat:.3f}; the expert is {self.expert - self.cheat:.3f}"
                f" above, at least {g.audit_margin:g} is asked ({g.audit})"
            )
        lines.append(
            f"paid         {100 * self.paid:.2f} % of random steps change it by {g.paid_by:g} or"
            f" more; at least {100 * g.paid:g} % is asked (flag)"
        )
        if self.stopped:
            worst = min(self.stopped, key=self.stopped.__getitem__)
            lines.append(
                f"stopping     the teacher {worst} ends {self.stopped[worst]:.3f} below finishing,"
                f" the least of {len(self.stopped)} ways; at least {g.stop_margin:g} is asked"
                f" ({g.stop})"
            )
        lines += [f"refused      {reason}" for reason in self.reasons]
        lines += [f"flagged      {flag}" for flag in self.flags]
        verdict = "passed" if self.passed else "refused"
        return "\n".join([*lines, f"verdict      {verdict}{', flagged' if self.flags else ''}"])


def gate_report(program: Program, settings: Settings, gates: Gates) -> GateReport:
    """Put a program through the gates; errors are as in ``collect``."""
    seen = collect(settings, gates)
    wild = random_signals(settings.definition, gates.random_signals, gates.seed)
    bad, lowest, highest = _extent(program, seen.moments)
    random_bad, random_lowest, random_highest = _extent(program, wild)

    def value(at: Signals) -> Tensor:
        total = potential(program(at))
        return total.clamp(gates.low, gates.top) if gates.range == "clip" else total

    def gained(before: Signals, after: Signals) -> Tensor:
        return value(after) - value(before)

    finals = {name: float(value(at).mean()) for name, at in seen.last.items()}
    paid = gained(seen.before, seen.after).abs() >= gates.paid_by
    report = GateReport(
        terms=program.terms,
        not_finite_random=random_bad,
        not_finite_recorded=bad,
        random_signals=gates.random_signals,
        recorded_moments=len(seen.moments),
        lowest=lowest,
        highest=highest,
        random_lowest=random_lowest,
        random_highest=random_highest,
        expert=finals["expert"],
        random=finals["random"],
        cheat=finals.get(CHEAT),
        paid=float(paid.double().mean()),
        stopped={how: float(gained(*ends).mean()) for how, ends in seen.stopped.items()},
        gates=gates,
    )
    reasons, flags = _judge(report, settings.definition.cheating)
    return replace(report, reasons=tuple(reasons), flags=tuple(flags))


def _judge(report: GateReport, cheating: str) -> tuple[list[str], list[str]]:
    """Why a program is refused, and what is flagged. "not >=" holds for NaN too."""
    g, reasons, flags = report.gates, [], []
    if bad := report.not_finite_random:
        reasons.append(f"not finite on {bad} of {report.random_signals} random signals")
    if bad := report.not_finite_recorded:
        reasons.append(f"not finite on {bad} of {report.recorded_moments} recorded moments")
    if g.range == "refuse":
        if not report.lowest >= g.low - g.tolerance:
            reasons.append(f"falls to {report.lowest:.3f}; the least allowed is {g.low:g}")
        if not report.highest <= g.top + g.tolerance:
            most = f"{g.high:g} and a bonus of {g.bonus:g}"
            reasons.append(f"rises to {report.highest:.3f}; the most allowed is {most}")
    above = report.expert - report.random
    if not above >= g.margin:
        least = f"at least {g.margin:g} is asked"
        reasons.append(f"the expert ends {above:.3f} above a random policy; {least}")
    below = g.audit_margin if report.cheat is None else report.expert - report.cheat
    if not below >= g.audit_margin:
        note = f"{cheating} ends {below:.3f} below the expert; at least {g.audit_margin:g} is asked"
        (reasons if g.audit == "refuse" else flags).append(note)
    for how, below in report.stopped.items():
        if not below >= g.stop_margin - g.tolerance:
            far = f"{-below:.3f} above" if below < 0 else f"only {below:.3f} below"
            note = f"the teacher {how} ends {far} finishing the task"
            (reasons if g.stop == "refuse" else flags).append(note)
    if not report.paid >= g.paid:
        flags.append(
            f"{100 * report.paid:.2f} % of random steps are paid; at least {100 * g.paid:g} % is"
            " asked: what is hardly ever paid is hardly ever learnt"
        )
    return reasons, flags


def _extent(program: Program, signals: Signals) -> tuple[int, float, float]:
    """At how many moments a term is not finite; least and greatest finite value, or NaN."""
    terms = program(signals)
    bad = int((~torch.stack([torch.isfinite(term) for term in terms.values()]).all(0)).sum())
    total = potential(terms)
    finite = total[torch.isfinite(total)]
    return (bad, float(finite.min()), float(finite.max())) if len(finite) else (bad, nan, nan)
