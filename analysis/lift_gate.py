"""Does a reward pay for the first 20 mm of a lift, from where an agent is stuck?

Exploratory, beside Q9 of docs/protocol.md. ``python -m analysis.lift_gate TABLE.csv RUN …`` flies
runs that grasp and do not lift, then moves the tip straight up, and asks the human reward and the
ten programs of the recording ``claude`` what they pay. An episode counts if the needle is
grasped, and not lifted, when the lift begins.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.controllers import rollout
from needlehoop.learning.evaluate import acting, load_agent
from needlehoop.learning.subject import flown_job
from needlehoop.rewards import potential, reference_reward
from needlehoop.rewards.language.program import compile_program
from needlehoop.rewards.program_reward import FLAVOURS, find
from needlehoop.runs.run import Run
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task

EPISODES, SEED = 100, 4242
STUCK, RISE = 60, 0.02
"""Steps after which an agent is taken to be stuck, and how far up the tip then goes, m."""


def programs(task: Task) -> Iterator[tuple[str, Callable[[Signals], dict[str, Tensor]]]]:
    """The human reward, and the programs of ``claude``, by name."""
    yield "human", reference_reward(task)
    for flavour in FLAVOURS.values():
        for sample in range(1, 6):
            source = find(("dep_front", "seg_side"), flavour, None, "", "claude", sample).text
            yield f"{flavour} {sample}", compile_program(source, task.signals)


def lifts(folder: Path) -> tuple[Task, Sequence[Signals], dict[str, float]]:
    """Moments ``(n,)`` of a run's agent: where it is stuck, one step up, and 20 mm up.

    And what it did when it was stuck: its mean action along z, and that action's deviation.
    """
    run = Run.open(folder)
    job, _ = flown_job(run.config(), (), trust=False)
    agent = load_agent(run, job, torch.device("cpu"))
    rules: Any = job.env.episode
    going = replace(rules, end_on_success=False, max_steps=2 * STUCK)
    settings = replace(job.env, seed=SEED, num_envs=EPISODES, episode=going)
    simulation = build(settings)
    act, steps = acting(agent.actor)(simulation), count()

    def up(signals: Signals) -> Tensor:
        action = act(signals)
        if next(steps) >= STUCK:
            action.zero_()
            action[:, 2] = 1.0
        return action

    # The tip follows its target within a step.
    whole = STUCK + round(RISE / rules.translation) + 1
    moments, actions = [], []
    for step in islice(rollout(simulation, up), whole + 1):
        moments.append(step.moment.signals.clone())
        actions.append(step.action)
    is_stuck = moments[STUCK].grasped & ~moments[STUCK].lifted
    rises = [moments[at][is_stuck] for at in (STUCK, STUCK + 1, whole)]
    deviation = agent.actor.head.log_sigma.exp()[2].item()
    stuck = {"z_action": float(actions[STUCK][is_stuck, 2].mean()), "deviation": deviation}
    return job.env.definition, rises, stuck


def table(folders: list[Path]) -> pd.DataFrame:
    """A row for each run and reward: what the first step up and 20 mm pay, on average."""
    rows = []
    for folder in folders:
        task, moments, stuck = lifts(folder)
        for name, reward in programs(task):
            before, first, last = (potential(reward(moment)) for moment in moments)
            rows.append(
                {
                    "agent": folder.parents[1].name,
                    "episodes": len(before),
                    **stuck,
                    "reward": name,
                    "first_step": float((first - before).mean()),
                    "rise": float((last - before).mean()),
                    "paid": float((last > before).double().mean()),
                }
            )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m analysis.lift_gate")
    parser.add_argument("to", type=Path, help="table to write")
    parser.add_argument("runs", type=Path, nargs="+", help="folders of runs by PPO")
    options = parser.parse_args()
    table(options.runs).to_csv(options.to, index=False, float_format="%.4g")
