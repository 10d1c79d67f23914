"""Cards: a reward program's figures at the gates, and whether it passes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from needlehoop.envs.settings import Settings
from needlehoop.rewards import potential
from needlehoop.rewards.language.program import Program
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task
from needlehoop.vlm.config import Gates
from needlehoop.vlm.moments import CHEAT, Trajectories, collect, random_signals


@dataclass(frozen=True)
class Card:
    """A program's figures, and why it was refused or flagged.

    ``lowest`` and ``highest`` are its values over the recorded moments, before clipping.
    ``random_lowest`` and ``random_highest`` are its finite values over the random signals.
    ``expert``, ``random`` and ``cheat`` are mean final values of the scripted controllers, clipped
    if the gates say so. The cheat is judged at the expert's ``elapsed``: it must not fail by being
    slow alone; it is ``None`` where the task has no such controller. ``paid`` is the share of a
    random policy's steps that change the value. An agent can hardly learn from a reward that random
    steps never change.
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
    reasons: tuple[str, ...]
    flags: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether no gate refuses the program. Flags do not refuse."""
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        """The card as plain values for JSON; a figure that is not finite is ``None``."""
        plain = {"passed": self.passed, **asdict(self)}
        return {name: _plain(value) for name, value in plain.items()}

    def __str__(self) -> str:
        g = self.gates
        lines = [
            f"terms        {', '.join(self.terms)}",
            f"not finite   {self.not_finite_random} of {self.random_signals} random signals,"
            f" {self.not_finite_recorded} of {self.recorded_moments} recorded moments",
            f"range        {self.lowest:.3f} to {self.highest:.3f} recorded"
            f" ({self.random_lowest:.3g} to {self.random_highest:.3g} on random signals);"
            f" allowed {g.low:g} to {g.high:g} + {g.bonus:g}, {g.range}",
            f"expert       {self.expert:.3f} at the end",
            f"random       {self.random:.3f}; the expert is {self.expert - self.random:.3f}"
            f" above, at least {g.margin:g} is asked",
            *(() if self.cheat is None else [self._audited(self.cheat)]),
            f"paid         {100 * self.paid:.2f} % of random steps change it by {g.paid_by:g} or"
            f" more; at least {100 * g.paid:g} % is asked (flag)",
            *(self._short() if self.stopped else ()),
            *(f"refused      {reason}" for reason in self.reasons),
            *(f"flagged      {flag}" for flag in self.flags),
            f"verdict      {'passed' if self.passed else 'refused'}"
            f"{', flagged' if self.flags else ''}",
        ]
        return "\n".join(lines)

    def _audited(self, cheat: float) -> str:
        g = self.gates
        return (
            f"cheat        {cheat:.3f}; the expert is {self.expert - cheat:.3f}"
            f" above, at least {g.audit_margin:g} is asked ({g.audit})"
        )

    def _short(self) -> tuple[str]:
        worst, g = min(self.stopped, key=self.stopped.__getitem__), self.gates
        return (
            f"stopping     the teacher {worst} ends {self.stopped[worst]:.3f} below finishing, the"
            f" least of {len(self.stopped)} ways; at least {g.stop_margin:g} is asked ({g.stop})",
        )


def card(
    program: Program,
    settings: Settings,
    gates: Gates,
    trajectories: Trajectories | None = None,
) -> Card:
    """Put a program through the gates.

    Args:
        program: compiled.
        settings: the environment in which trajectories are recorded. Its cameras, its reward
            and its number of environments do not matter.
        gates: what the program must pass.
        trajectories: those of an earlier ``collect``, which takes a second or two.
    """
    seen = collect(settings, gates) if trajectories is None else trajectories
    wild = random_signals(settings.definition, gates.random_signals, gates.seed)
    recorded, on_wild = _total(program, seen.moments), _total(program, wild)
    bad_recorded, bad_wild = _count_bad(program, seen.moments), _count_bad(program, wild)
    finals = {who: _judged(program, last, gates) for who, last in _level(seen.last).items()}
    figures = {who: float(final.mean()) for who, final in finals.items()}
    found = Card(
        terms=program.terms,
        not_finite_random=bad_wild,
        not_finite_recorded=bad_recorded,
        random_signals=gates.random_signals,
        recorded_moments=len(recorded),
        lowest=_extreme(recorded, torch.min),
        highest=_extreme(recorded, torch.max),
        random_lowest=_extreme(on_wild, torch.min),
        random_highest=_extreme(on_wild, torch.max),
        expert=figures["expert"],
        random=figures["random"],
        cheat=figures.get(CHEAT),
        paid=_paid(program, seen, gates),
        stopped={
            how: float((_judged(program, whole, gates) - _judged(program, short, gates)).mean())
            for how, (short, whole) in seen.stopped.items()
        },
        gates=gates,
        reasons=(),
        flags=(),
    )
    reasons, flags = _refusals(found), ()
    for refuses, said in (
        (gates.audit == "refuse", _audit(found, settings.definition)),
        (gates.stop == "refuse", _stopping(found)),
        (False, _seldom(found)),
    ):
        reasons, flags = (reasons + said, flags) if refuses else (reasons, flags + said)
    return replace(found, reasons=reasons, flags=flags)


def values_of(program: Program, seen: Trajectories, gates: Gates) -> Tensor:
    """A program's value at every recorded moment, ``(total,)``, clipped if the gates say so."""
    return _judged(program, seen.moments, gates)


def _refusals(c: Card) -> tuple[str, ...]:
    g, reasons = c.gates, []
    for count, of, what in (
        (c.not_finite_random, c.random_signals, "random signals"),
        (c.not_finite_recorded, c.recorded_moments, "recorded moments"),
    ):
        if count:
            reasons.append(f"not finite on {count} of {of} {what}")
    if g.range == "refuse":
        # "not >=" refuses NaN too, which compares false with everything.
        if not c.lowest >= g.low - g.tolerance:
            reasons.append(f"falls to {c.lowest:.3f}; the least allowed is {g.low:g}")
        if not c.highest <= g.top + g.tolerance:
            reasons.append(
                f"rises to {c.highest:.3f}; the most allowed is {g.high:g} and a bonus of"
                f" {g.bonus:g}"
            )
    if not c.expert - c.random >= g.margin:
        reasons.append(
            f"the expert ends {c.expert - c.random:.3f} above a random policy; at least"
            f" {g.margin:g} is asked"
        )
    return tuple(reasons)


def _audit(c: Card, task: Task) -> tuple[str, ...]:
    if c.cheat is None or c.expert - c.cheat >= c.gates.audit_margin:
        return ()
    return (
        f"{task.cheating} ends {c.expert - c.cheat:.3f} below the expert;"
        f" at least {c.gates.audit_margin:g} is asked",
    )


def _stopping(c: Card) -> tuple[str, ...]:
    return tuple(
        f"the teacher {how} ends {-below:.3f} above finishing the task"
        if below < 0
        else f"the teacher {how} ends only {below:.3f} below finishing the task"
        for how, below in c.stopped.items()
        # "not >=" flags NaN too.
        if not below >= c.gates.stop_margin - c.gates.tolerance
    )


def _seldom(c: Card) -> tuple[str, ...]:
    if c.paid >= c.gates.paid:
        return ()
    return (
        f"{100 * c.paid:.2f} % of random steps are paid; at least {100 * c.gates.paid:g} % is"
        " asked: what is hardly ever paid is hardly ever learnt",
    )


def _level(last: Mapping[str, Signals]) -> dict[str, Signals]:
    """The last moments, with the expert's ``elapsed`` in place of the cheat's."""
    if CHEAT not in last:
        return dict(last)
    cheat = last[CHEAT].clone()
    cheat.elapsed = last["expert"].elapsed.clone()
    return {**last, CHEAT: cheat}


def _total(program: Program, signals: Signals) -> Tensor:
    return potential(program(signals))


def _judged(program: Program, signals: Signals, gates: Gates) -> Tensor:
    total = _total(program, signals)
    return total.clamp(gates.low, gates.top) if gates.range == "clip" else total


def _paid(program: Program, seen: Trajectories, gates: Gates) -> float:
    """Share of random steps that change the judged value."""
    change = _judged(program, seen.after, gates) - _judged(program, seen.before, gates)
    return float((change.abs() >= gates.paid_by).double().mean())


def _count_bad(program: Program, signals: Signals) -> int:
    """Moments at which some term is not finite."""
    terms = program(signals).values()
    return int((~torch.stack([torch.isfinite(term) for term in terms]).all(0)).sum())


def _extreme(total: Tensor, of: Any) -> float:
    finite = total[torch.isfinite(total)]
    return float(of(finite)) if len(finite) else float("nan")


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not torch.isfinite(torch.tensor(value)):
        return None
    return list(value) if isinstance(value, tuple) else value
