"""Gates: what a reward program must pass before anybody trains on it.

A gate that is not passed refuses the program; the cheat audit only flags it, unless told
to refuse, because most honest rewards cannot tell touching from threading. Every gate's
figures are in the program's ``Card``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from needlehoop.envs.controllers import CONTROLLERS, controller
from needlehoop.envs.rollout import Controller
from needlehoop.envs.settings import Settings, build
from needlehoop.envs.simulation import Simulation
from needlehoop.rewards import NONE, potential
from needlehoop.rewards.language.program import Program
from needlehoop.scene.signals import TABLE, Signals

CHEATING = "touching the goal without threading"
"""How a card says what the audit found; no model is told (see ``workshop``)."""

_REACH = 0.3
"""Random points lie within this of the origin along each axis, m."""
_TURN = 3.2
"""Random angles lie within this of 0, rad."""


@dataclass(frozen=True)
class Gates:
    """What is asked; values in ``conf/gates``."""

    random_signals: int
    episodes: int
    """Episodes of each controller."""
    seed: int
    low: float
    high: float
    bonus: float
    """What may come on top of ``high``."""
    range: str
    """``refuse`` or ``clip``."""
    tolerance: float
    margin: float
    """Of the expert over a random policy."""
    audit: str
    """``flag`` or ``refuse``."""
    audit_margin: float
    """Of the expert over the cheat."""

    def __post_init__(self) -> None:
        for key, valid in (("range", ("refuse", "clip")), ("audit", ("flag", "refuse"))):
            value = getattr(self, key)
            if value not in valid:
                raise ValueError(
                    f"gates.{key}: {value!r} is unknown; choose from {', '.join(valid)}"
                )
        for key, least in (("random_signals", 1), ("episodes", 1), ("seed", 0)):
            if getattr(self, key) < least:
                raise ValueError(f"gates.{key}: {getattr(self, key)} must be at least {least}")
        if not self.low < self.top:
            raise ValueError(f"gates.low: {self.low} must be below high + bonus = {self.top}")

    @property
    def top(self) -> float:
        """The largest value that is allowed."""
        return self.high + self.bonus


@dataclass(frozen=True)
class Trajectories:
    """What the scripted controllers went through.

    Args:
        moments: every moment of every episode, ``(total,)``, the starts included.
        last: each episode's last moment, ``(episodes,)``, by controller.
    """

    moments: Signals
    last: dict[str, Signals]


@dataclass(frozen=True)
class Card:
    """A program's figures, and why it was refused or flagged.

    ``lowest`` and ``highest`` are over the recorded moments, before any clipping, and so are
    ``random_lowest`` and ``random_highest`` over the finite ones of the random signals.
    ``expert``, ``random`` and ``cheat`` are mean final values, clipped if asked; ``cheat`` is
    judged at the expert's ``elapsed``, so that it does not lose by being slow.
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
    cheat: float
    gates: Gates
    reasons: tuple[str, ...]
    flags: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing refuses the program; flags do not."""
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
            f"cheat        {self.cheat:.3f}; the expert is {self.expert - self.cheat:.3f}"
            f" above, at least {g.audit_margin:g} is asked ({g.audit})",
            *(f"refused      {reason}" for reason in self.reasons),
            *(f"flagged      {flag}" for flag in self.flags),
            f"verdict      {'passed' if self.passed else 'refused'}"
            f"{', flagged' if self.flags else ''}",
        ]
        return "\n".join(lines)


def card(
    program: Program,
    settings: Settings,
    gates: Gates,
    trajectories: Trajectories | None = None,
) -> Card:
    """Put a program through the gates.

    Args:
        program: compiled.
        settings: the environment that trajectories are recorded in; its cameras, reward
            and number of environments do not matter.
        gates: what is asked.
        trajectories: of an earlier ``collect``, to save the second or two.
    """
    seen = collect(settings, gates) if trajectories is None else trajectories
    wild = random_signals(gates.random_signals, gates.seed)
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
        cheat=figures["cheat"],
        gates=gates,
        reasons=(),
        flags=(),
    )
    reasons, audit = _refusals(found), _audit(found)
    if gates.audit == "refuse":
        return replace(found, reasons=reasons + audit)
    return replace(found, reasons=reasons, flags=audit)


def _refusals(c: Card) -> tuple[str, ...]:
    g, reasons = c.gates, []
    for count, of, what in (
        (c.not_finite_random, c.random_signals, "random signals"),
        (c.not_finite_recorded, c.recorded_moments, "recorded moments"),
    ):
        if count:
            reasons.append(f"not finite on {count} of {of} {what}")
    if g.range == "refuse":
        # Written so that NaN, which compares false with everything, is refused.
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


def _audit(c: Card) -> tuple[str, ...]:
    if c.expert - c.cheat >= c.gates.audit_margin:
        return ()
    return (
        f"{CHEATING} ends {c.expert - c.cheat:.3f} below the expert;"
        f" at least {c.gates.audit_margin:g} is asked",
    )


def collect(settings: Settings, gates: Gates) -> Trajectories:
    """One episode of the expert, a random policy and the cheat in each of ``gates.episodes``
    environments of ``gates.seed``, without cameras.

    Raises:
        ValueError: settings that the scripts cannot drive, by key.
    """
    blind = replace(
        settings,
        cams=(),
        num_envs=gates.episodes,
        seed=gates.seed,
        # Not looked at: the moments are scored later, by as many programs as need be.
        reward=NONE,
        # The cheat must get to stay where it is, and the expert to stop once through.
        episode=replace(settings.episode, end_on_success=True),
    )
    simulation, _ = build(blind)
    moments: list[Signals] = []
    last = {}
    for who in CONTROLLERS:
        simulation.reseed(gates.seed)
        lived, last[who] = _episodes(simulation, controller(who, blind))
        moments += lived
    joined: Any = torch.cat(moments)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return Trajectories(joined, last)


def _episodes(simulation: Simulation, act: Controller) -> tuple[list[Signals], Signals]:
    """The moments of episodes while they go on, step by step, and each episode's last."""
    signals = simulation.reset().signals
    lived, last = [signals.clone()], signals.clone()
    going = torch.ones(simulation.num_envs, dtype=torch.bool)
    while bool(going.any()):
        moment = simulation.step(act(signals))
        signals = moment.signals
        now: Any = signals[going].clone()
        lived.append(now)
        last[going] = now
        going &= ~(moment.terminated | moment.truncated)
    return lived, last


def random_signals(count: int, seed: int) -> Signals:
    """``count`` moments drawn from the table: each possible by itself, together often not.

    Points within ±0.3 m, unit quaternions and axes, angles within ±3.2 rad, insertion within
    0 to 0.24 m, shares of 0 to 1, facts true or false. Each in eight, all points coincide,
    because that is where a division by a distance shows.
    """
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    fields = {}
    for name, signal in TABLE.items():
        shape = (count, *signal.shape)
        if signal.unit == "bool":
            fields[name] = uniform(*shape) < 0.5
        elif signal.unit == "m":
            fields[name] = _REACH * (2 * uniform(*shape) - 1)
        elif signal.shape:
            fields[name] = 2 * uniform(*shape) - 1
            if signal.unit == "1":
                fields[name] /= torch.linalg.vector_norm(fields[name], dim=-1, keepdim=True)
            else:
                fields[name] *= _TURN
        else:
            fields[name] = (
                uniform(*shape) if signal.unit == "1" else _TURN * (2 * uniform(count) - 1)
            )
    fields["joints"][:, 2] = 0.24 * uniform(count)
    points = [name for name, signal in TABLE.items() if signal.unit == "m"]
    for name in points:
        fields[name][::8] = fields[points[0]][::8]
    return Signals(**fields, batch_size=[count])


def _level(last: Mapping[str, Signals]) -> dict[str, Signals]:
    """The last moments, with the cheat's clock put to the expert's."""
    cheat = last["cheat"].clone()
    cheat.elapsed = last["expert"].elapsed.clone()
    return {**last, "cheat": cheat}


def _total(program: Program, signals: Signals) -> Tensor:
    return potential(program(signals))


def _judged(program: Program, signals: Signals, gates: Gates) -> Tensor:
    total = _total(program, signals)
    return total.clamp(gates.low, gates.top) if gates.range == "clip" else total


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
