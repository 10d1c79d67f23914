"""What happens to the memory of a task between two looks at the scene. No physics, no pay."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import DIVERGED, Memory, Task, Weld
from needlehoop.tasks.layout import Episode, Layout
from needlehoop.tasks.start import Start


def begin(task: Task, rules: Episode, start: Start) -> Memory:
    """The memory when an episode begins: targets where the robot is, nothing true yet."""
    # Slow to import.
    from tensordict import TensorDict

    n = len(start)
    names = [fact.name for fact in task.facts if fact.remembered]
    names += [f"has_{fact.name}" for fact in task.facts if fact.once]
    no = {name: torch.zeros(n, dtype=torch.bool) for name in names}
    counted = ["steps", *(f"{fact.name}_since" for fact in task.facts if fact.timed)]
    zero = {name: torch.zeros(n, dtype=torch.int64) for name in counted}
    return TensorDict({**task.robot.begin(rules, start), **no, **zero}, [n])


def act(
    task: Task, layout: Layout, rules: Episode, memory: Memory, action: Tensor
) -> tuple[Memory, Tensor]:
    """Move the robot's targets by an action ``(n, action_size)``, clamped to [-1, 1].

    Returns:
        The memory with targets moved and a step more, and the servos' commands ``(n, nu)``.

    Raises:
        ValueError: wrong shape, or a value that is not finite.
    """
    expected = (*memory.batch_size, rules.action_size)
    if tuple(action.shape) != expected:
        raise ValueError(
            f"action: shape {tuple(action.shape)}; expected {expected} for control={rules.control}"
        )
    finite = torch.isfinite(action).all(-1)
    if not bool(finite.all()):
        bad = (~finite).nonzero().flatten().tolist()
        raise ValueError(f"action: not finite in environments {bad}; expected numbers in [-1, 1]")
    clamped = action.to(torch.float64).clamp(-1.0, 1.0)
    moved, control = task.robot.act(layout, rules, memory, clamped)
    return memory.replace({**moved, "steps": memory["steps"] + 1}), control


def observe(
    task: Task, layout: Layout, rules: Episode, memory: Memory, readings: Mapping[str, Tensor]
) -> tuple[Memory, Signals, dict[str, Tensor], dict[str, Weld]]:
    """Decide the facts from readings and the memory after the action.

    Returns:
        The memory from now on; the signals; the facts ``(n,)`` bool by name, in the order of
        ``Task.all_facts``, without ``diverged``, which the engine tells; and the welds.
    """
    facts, welds = task.observe(layout, rules, memory, readings)
    kept = {fact.name: facts[fact.name] for fact in task.facts if fact.remembered}
    for fact in task.facts:
        if fact.once:
            kept[f"has_{fact.name}"] = memory[f"has_{fact.name}"] | facts[fact.name]
        if fact.timed:
            since = f"{fact.name}_since"
            kept[since] = torch.where(facts[fact.name], memory[since], memory["steps"])
    memory = memory.replace(kept)
    fields = {
        **readings,
        **{name: memory[kept] for name, kept in task.robot.commands.items()},
        "elapsed": memory["steps"].double() / rules.max_steps,
        **facts,
    }
    signals = task.signals_class(**fields, batch_size=memory.batch_size)
    done = facts[task.goal] if task.success is None else task.success(rules, signals)
    known = {**kept, **facts, "success": done}
    if task.cheat is not None:
        known["cheat"] = task.cheat(memory, signals)
    ordered = {name: known[name] for name in task.all_facts if name in known}
    return memory, signals, ordered, welds


def ends(rules: Episode, memory: Memory, facts: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Whether success ends episodes, and else whether time or divergence does; ``(n,)`` bool."""
    terminated = facts["success"] & rules.end_on_success
    late = memory["steps"] >= rules.max_steps
    return terminated, (late | facts[DIVERGED]) & ~terminated
