"""Evaluates a policy on episodes of its own: with its mean action, and with actions drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.stats import binomtest
from torch import Tensor

from needlehoop.config.strict import check_names
from needlehoop.envs.build import build
from needlehoop.envs.controllers import Controller, MakeController, Outcome, run_batches
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Observer, Simulation
from needlehoop.learning.job import Job
from needlehoop.learning.learner import build_agent
from needlehoop.learning.networks import Actor, Agent
from needlehoop.learning.policy import fitting, read_step, read_weights
from needlehoop.pictures.film import record
from needlehoop.rewards import reference_reward
from needlehoop.runs.files import BEST, CHECKPOINT, POLICIES, POLICY
from needlehoop.runs.run import Run
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task

SAMPLED = "success_sampled"
"""Success on the same episodes with actions drawn at random, as in training."""


def acting(actor: Actor, sampled: bool = False) -> MakeController:
    """Makes controllers of a policy, whose actions are drawn if ``sampled``, else the mean."""
    device = next(actor.parameters()).device

    def make(simulation: Simulation) -> Controller:
        observer, seed = Observer(simulation), simulation.settings.seed
        # A generator for each environment, so an episode does not depend on how many there are.
        noise = [
            np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(env,)))
            for env in (simulation.envs.tolist() if sampled else [])
        ]

        def act(signals: Signals) -> Tensor:
            seen = observer(signals)
            images: Any = seen.pop("pixels", {})
            observed = [x.to(device) for x in (*images.values(), *seen.values())]
            size = simulation.episode.action_size
            rows = [generator.standard_normal(size, np.float32) for generator in noise]
            drawn = torch.from_numpy(np.stack(rows)).to(device) if sampled else None
            with torch.no_grad():
                return actor(*observed, noise=drawn).to(simulation.device)

        return act

    return make


def evaluate(settings: Settings, agent: Agent, episodes: int, sampled: bool = False) -> Outcome:
    """Run the first episode of ``episodes`` environments of the settings' seed."""
    return run_batches(settings, episodes, size=50, make=acting(agent.actor, sampled))


def _both_ways(
    job: Job, agent: Agent, episodes: int, seed: int
) -> tuple[Outcome, dict[str, float]]:
    """The outcome with mean actions, and the success with drawn ones on the same episodes."""
    settings = replace(job.env, seed=seed)
    mean, drawn = (evaluate(settings, agent, episodes, sampled) for sampled in (False, True))
    return mean, {SAMPLED: float(drawn.success.double().mean())}


def on_the_way(job: Job, agent: Agent) -> dict[str, float | int]:
    """The numbers of a row of ``evaluations.csv``, for an agent in training."""
    mean, drawn = _both_ways(job, agent, job.evaluation.episodes, job.evaluation.seed)
    return {**mean.summary(), **drawn}


def assess(agent: Agent, job: Job, episodes: int, seed: int) -> dict[str, Any]:
    """Evaluate an agent at length; ``ValueError`` for no episodes or the training's seed."""
    check_seed(job, seed)
    mean, drawn = _both_ways(job, agent, episodes, seed)
    return {"seed": seed, **with_intervals(job.env.definition, mean), **drawn}


def check_seed(job: Job, seed: int) -> None:
    """Raises ``ValueError`` for the seed of the training."""
    if seed == job.env.seed:
        raise ValueError(f"seed: the run was trained on {seed}; choose another")


def film(job_env: Settings, agent: Agent, episodes: int, seed: int, out: Path) -> None:
    """Write a video of the agent, an ``.mp4``, with its cameras' images beside the scene."""
    simulation = build(replace(job_env, num_envs=1, seed=seed))
    record(simulation, acting(agent.actor)(simulation), episodes, out)


def which_policy(run: Run, policy: str | None) -> tuple[str, int | None]:
    """Which of a run's policies is meant, and how many steps it was trained for.

    ``policy``: ``last`` or ``best``; ``None``: the last, or else the best. Raises ``ValueError``
    where the run has no such policy.
    """
    if policy is not None:
        check_names("policy", [policy], [*POLICIES])
    best = run.folder / BEST
    last = any((run.folder / name).exists() for name in (CHECKPOINT, POLICY))
    if policy == "last" or (policy is None and (last or not best.exists())):
        return "last", run.manifest().get("steps")
    if not best.exists():
        raise ValueError(f"policy: {run.folder} has no {BEST}; there was no evaluation on the way")
    return "best", read_step(best)


def policy_in_words(which: str, steps: int | None) -> str:
    """In words: ``best, after 1,024,000 steps``."""
    return which if steps is None else f"{which}, after {steps:,} steps"


def load_agent(run: Run, job: Job, device: torch.device, policy: str = "last") -> Agent:
    """One of a run's agents.

    ``policy``: ``last``, which is the checkpoint's or else that of ``policy.safetensors``; or
    ``best``, that of ``best.safetensors``. The value function of such a file is untrained. Raises
    ``ValueError`` where there is none, or it is damaged or of another run.
    """
    weights, checkpoint = run.folder / POLICIES[policy], run.folder / CHECKPOINT
    agent = build_agent(job, device)
    # Also before the checkpoint is read, so that a damaged file is noticed.
    if weights.exists() or policy == "best":
        read_weights(weights, agent.actor)
    if policy == "last" and (checkpoint.exists() or not weights.exists()):
        state = run.checkpoint()
        with fitting(str(checkpoint)):
            agent.load_state_dict(state["learner"][job.algo.kind]["agent"])
    return agent


def with_intervals(task: Task, outcome: Outcome) -> dict[str, Any]:
    """An outcome's summary, with 95 % Wilson intervals of success and cheats."""
    n, summary = len(outcome.steps), dict[str, Any](outcome.summary())
    for name, fact in outcome.facts.items():
        if name in ("success", "cheat"):
            summary[f"{name}_95"] = wilson(int(fact.sum()), n)
    spread = float(outcome.potential.std()) if n > 1 else None
    unit = getattr(reference_reward(task), "unit", None)
    return {**summary, "return_sd": spread, "human_unit": unit}


def wilson(count: int, n: int) -> list[float]:
    """Lower and upper end of a share's 95 % Wilson interval, with four digits."""
    interval = binomtest(count, n).proportion_ci(method="wilson")
    return [round(float(interval.low), 4), round(float(interval.high), 4)]


def report(task: Task, evaluation: Mapping[str, Any]) -> str:
    """An evaluation as a few lines of text."""
    f = evaluation
    spread = "" if f["return_sd"] is None else f" ± {f['return_sd']:.2f}"
    unit = "" if f["human_unit"] is None else f", scene unit {f['human_unit']:g} m"
    lines = [
        f"episodes     {f['episodes']} (seed {f['seed']})",
        f"success      {_share(f, 'success')}",
        f"sampled      {f[SAMPLED]:.1%} (success with actions drawn as in training)",
        f"return       {f['return']:.2f}{spread}"
        f" (final potential; {f['return_min']:.2f} to {f['return_max']:.2f})",
        f"human        {f['return_human']:.2f} (final potential of the human reward{unit})",
    ]
    if task.cheat is not None:
        lines.append(f"cheat        {_share(f, 'cheat')}")
    lines += [f"{fact.name:12} {f[fact.name]:.1%}" for fact in task.facts]
    lines.append(f"length       {f['steps']:.0f} steps")
    if f["diverged"]:
        lines.append(f"diverged     {f['diverged']:.1%}")
    return "\n".join(lines)


def _share(evaluation: Mapping[str, Any], name: str) -> str:
    low, high = evaluation[f"{name}_95"]
    return f"{evaluation[name]:.1%} (95 %: {low:.1%} to {high:.1%})"
