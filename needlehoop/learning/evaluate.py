"""Deterministic evaluation of a policy on episodes of its own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from scipy.stats import binomtest
from torch import Tensor

from needlehoop.envs.build import build
from needlehoop.envs.images import Imager
from needlehoop.envs.observer import Observer
from needlehoop.envs.rollout import Controller, MakeController, Outcome, run_batches
from needlehoop.envs.settings import Settings
from needlehoop.envs.simulation import Simulation
from needlehoop.envs.torchrl_env import TorchRLEnv
from needlehoop.learning.agent import Actor, Agent
from needlehoop.learning.checkpoint import check_agent, check_state
from needlehoop.learning.job import Job
from needlehoop.learning.learner import agent_state, build_agent
from needlehoop.learning.weights import read_weights
from needlehoop.pictures.film import record
from needlehoop.pictures.window import Window, play
from needlehoop.rewards import NONE, reference_reward
from needlehoop.runs.files import CHECKPOINT, EVALUATION, POLICY
from needlehoop.runs.run import Run
from needlehoop.scene.signals import Signals
from needlehoop.tasks.contract import Task

_BATCH = 50


def acting(actor: Actor) -> MakeController:
    """Makes a policy, acting on its mean, the controller of any simulation it was made for."""
    device = next(actor.parameters()).device

    def make(settings: Settings, simulation: Simulation, imager: Imager) -> Controller:
        observer = Observer(settings, simulation, imager)

        def act(signals: Signals) -> Tensor:
            seen = observer(signals)
            images: Any = seen.pop("pixels", {})
            with torch.no_grad():
                return actor(*(x.to(device) for x in (*images.values(), *seen.values()))).cpu()

        return act

    return make


def evaluate(settings: Settings, agent: Agent, episodes: int) -> Outcome:
    """Run the first episode of ``episodes`` environments of the settings' seed.

    Args:
        settings: the environment that the agent was made for, with the evaluation's seed.
        agent: on the device where it is to run.
        episodes: how many; episode ``i`` is the same however many there are.

    Raises:
        ValueError: fewer than one episode.
    """
    return run_batches(settings, episodes, _BATCH, acting(agent.actor))


def film(job_env: Settings, agent: Agent, episodes: int, seed: int, out: Path) -> None:
    """A video of the agent at work, with its own cameras' images beside the scene.

    Args:
        job_env: the environment that the agent was made for.
        agent: on the device where it is to run.
        episodes: how many.
        seed: of the episodes.
        out: an ``.mp4`` file; written whole or not at all.
    """
    alone, simulation, imager, act = _alone(job_env, agent, seed)
    record(alone, simulation, imager, act, episodes, out)


def show(job_env: Settings, agent: Agent, episodes: int, seed: int) -> None:
    """The same episodes in a window, in real time.

    Raises:
        RuntimeError: this machine has no display.
    """
    alone, simulation, _, act = _alone(job_env, agent, seed)
    window = Window(simulation, alone, "a film shows the same")
    play(window, alone, simulation, act, range(episodes))


def assess(
    run: Run, agent: Agent, job: Job, episodes: int, seed: int, *, kept: bool = True
) -> dict[str, Any]:
    """Evaluate a run's agent and write ``evaluation.json`` into its folder; returns it.

    Args:
        run: whose folder.
        agent: on the device where it is to run.
        job: of the run.
        episodes: how many.
        seed: of the episodes; not the training's.
        kept: whether to write it: not for another reward than the run's own.

    Raises:
        ValueError: no episodes, or the seed of the training.
    """
    found = {"steps_trained": run.manifest().get("steps"), **try_out(agent, job, episodes, seed)}
    if kept:
        run.write(EVALUATION, json.dumps(found, indent=2) + "\n")
    return found


def try_out(agent: Agent, job: Job, episodes: int, seed: int) -> dict[str, Any]:
    """Evaluate an agent on episodes that it was not trained on; arguments as in ``assess``."""
    if seed == job.env.seed:
        raise ValueError(f"seed: the run was trained on {seed}; choose another")
    if seed < 0:
        raise ValueError(f"seed: {seed} is negative")
    outcome = evaluate(replace(job.env, seed=seed), agent, episodes)
    return {"seed": seed, **with_intervals(job.env.definition, outcome)}


def load_agent(run: Run, job: Job, device: torch.device) -> Agent:
    """The agent of a run's last checkpoint; without one, the policy of ``policy.safetensors``.

    With the latter its value function is untrained.

    Raises:
        ValueError: neither of them, or one that is damaged or of another run.
    """
    weights = run.folder / POLICY
    state = None
    if (run.folder / CHECKPOINT).exists() or not weights.exists():
        state = run.checkpoint().state
        check_state(run.folder / CHECKPOINT, state, job)
    # Networks do not depend on the reward, and a stranger's may be code.
    alone = replace(job.env, num_envs=1, reward=NONE)
    agent = build_agent(job, TorchRLEnv(alone), device)
    if state is None:
        read_weights(weights, agent.actor)
    else:
        check_agent(state["learner"], agent)
        agent.load_state_dict(agent_state(state["learner"]))
    return agent


def with_intervals(task: Task, outcome: Outcome) -> dict[str, Any]:
    """An outcome's summary, with 95 % Wilson intervals of success and cheats."""
    summary = outcome.summary()
    n = int(summary["episodes"])
    intervals = {}
    for name in ("success", "cheat"):
        if name in summary:
            found = binomtest(round(summary[name] * n), n).proportion_ci(method="wilson")
            intervals[f"{name}_95"] = [round(float(found.low), 4), round(float(found.high), 4)]
    spread = float(outcome.potential.std()) if n > 1 else None
    unit = getattr(reference_reward(task), "unit", None)
    return {**summary, **intervals, "return_sd": spread, "human_unit": unit}


def report(task: Task, found: Mapping[str, Any]) -> str:
    """An evaluation as a few lines of text."""
    f = found
    spread = "" if f["return_sd"] is None else f" ± {f['return_sd']:.2f}"
    unit = "" if f["human_unit"] is None else f", scene unit {f['human_unit']:g} m"
    lines = [
        f"episodes     {f['episodes']} (seed {f['seed']})",
        f"success      {_share(f, 'success')}",
        f"return       {f['return']:.2f}{spread}"
        f" (final potential; {f['return_min']:.2f} to {f['return_max']:.2f})",
        f"human        {f['return_human']:.2f} (final potential of the human reward{unit})",
    ]
    if task.cheat is not None:
        lines.append(f"cheat        {_share(f, 'cheat')}")
    lines += [f"{fact.name:12} {f[fact.name]:.1%}" for fact in task.facts]
    lines.append(f"length       {f['steps']:.0f} steps")
    return "\n".join([*lines, *([f"diverged     {f['diverged']:.1%}"] if f["diverged"] else [])])


def _share(found: Mapping[str, Any], name: str) -> str:
    low, high = found[f"{name}_95"]
    return f"{found[name]:.1%} (95 %: {low:.1%} to {high:.1%})"


def _alone(
    job_env: Settings, agent: Agent, seed: int
) -> tuple[Settings, Simulation, Imager, Controller]:
    """One environment, and the agent as its controller."""
    alone = replace(job_env, num_envs=1, seed=seed)
    simulation, imager = build(alone)
    return alone, simulation, imager, acting(agent.actor)(alone, simulation, imager)
