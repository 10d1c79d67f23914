"""Train an agent: collect a buffer, learn from it, write the results down.

``train`` is the method. ``python train.py`` and ``needlehoop train`` come here with a composed
config, once for each run (``cli/train.py``).
"""

from __future__ import annotations

import json
import math
import shlex
import time
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import torch
from tensordict import TensorDictBase
from tqdm import tqdm

from needlehoop.learning.evaluate import assess, film, load_agent, on_the_way, report
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.learning.loggers import Logger
from needlehoop.learning.policy import write_weights
from needlehoop.runs.files import BEST, EVALUATION, EVALUATIONS, METRICS, POLICY, VIDEO
from needlehoop.runs.machine import interruption, peak_memory
from needlehoop.runs.reading import read_json
from needlehoop.runs.run import Run
from needlehoop.training.session import open_session


def train(
    job: Job,
    run: Run,
    logger: Logger,
    state: dict[str, Any] | None = None,
    weights: dict[str, Any] | None = None,
    until: int | None = None,
) -> str:
    """Train until the job's steps are done, a signal asks to stop, or ``until`` of them are done.

    It goes on from the checkpoint ``state``, or begins with the ``weights`` of another run's agent.

    Returns ``done``; or ``stopped`` by a signal or ``paused`` by ``until``, with a checkpoint.
    ``FloatingPointError``: a loss is not finite; what was learnt before is in the checkpoint.
    """
    columns = job.env.definition.columns
    shown = {"return": math.nan, "success": math.nan}
    whole = {"total": job.updates * job.buffer, "unit": "step", "unit_scale": True}
    with (
        closing(Learner(job, state and state["learner"], weights)) as learner,
        tqdm(initial=learner.steps, **whole) as bar,
        interruption() as stop_request,
    ):
        began = time.perf_counter() - (state["wall_time"] if state else 0.0)
        for buffer, losses in learner:
            update = learner.done_updates
            for name, value in losses.items():
                if name.startswith("loss_") and not math.isfinite(value):
                    raise FloatingPointError(
                        f"training came apart in update {update}: {name} is {value}; try a smaller"
                        " algo.learning_rate"
                    )
            at = {"update": update, "step": learner.steps, "wall_time": time.perf_counter() - began}
            rate = job.buffer / (losses["seconds_collect"] + losses["seconds_update"])
            row = {**at, "steps_per_second": rate, **_episode_columns(buffer, columns), **losses}
            row["memory_gb"] = peak_memory()
            run.append(METRICS, row)
            logger.log("train", row)
            shown |= {name: row[name] for name in shown if not math.isnan(row[name])}
            bar.set_postfix({name: f"{value:.2f}" for name, value in shown.items()})
            bar.update(job.buffer)

            if job.evaluation.every and update % job.evaluation.every == 0:
                evaluation = {**at, **on_the_way(job, learner.agent)}
                run.append(EVALUATIONS, evaluation)
                logger.log("evaluation", evaluation)
                # Before the checkpoint. A run that is killed between them comes here again, with
                # the same weights.
                if _is_best(run):
                    path, actor = run.folder / BEST, learner.agent.actor
                    write_weights(path, job.spec, actor, run.config(), job.weights, evaluation)

            paused = until is not None and until <= learner.steps and update < job.updates
            stopping = stop_request.is_set() or paused
            if stopping or update % job.checkpoint_every == 0 or update == job.updates:
                wall = time.perf_counter() - began
                run.save({"learner": learner.state_dict(), "update": update, "wall_time": wall})
                run.note(steps=learner.steps, wall_time=round(wall, 1), stopped=stopping)
            if stopping:
                break
    if learner.done_updates == job.updates:
        return "done"
    return "stopped" if stop_request.is_set() else "paused"


def _episode_columns(buffer: TensorDictBase, facts: Mapping[str, str]) -> dict[str, float]:
    """Means over the episodes that ended in a buffer ``(num_envs, horizon)``; NaN for none.

    The return is the final potential; ``length`` is in steps; ``facts`` are a ``Task.columns``.
    """
    following: Any = buffer["next"]
    last = following[following["done"].squeeze(-1)]
    return {
        "episodes": float(len(last)),
        "return": float(last["potential"].mean()),
        **{f"term_{name}": float(term.mean()) for name, term in last["terms"].items()},
        **{name: float(last["facts", fact].float().mean()) for name, fact in facts.items()},
        "length": float(last["steps"].float().mean()),
    }


def _is_best(run: Run) -> bool:
    """Whether the newest evaluation is the best: by success, then by return; a tie goes to it."""
    marks = [(float(row["success"]), float(row["return"])) for row in run.rows(EVALUATIONS)]
    return marks[-1] >= max(marks)


def finish(job: Job, run: Run, logger: Logger) -> None:
    """Evaluate the trained agent at length, film it, and print the results."""
    # Always one, so that the evaluation's bits do not depend on the training's threads.
    torch.set_num_threads(1)
    agent = load_agent(run, job, job.torch_device)
    write_weights(run.folder / POLICY, job.spec, agent.actor, run.config(), job.weights)
    settings = job.evaluation
    films = f", then a film of {settings.video_episodes}" if settings.video_episodes else ""
    print(f"\nevaluating {settings.final_episodes} episodes{films}", flush=True)
    evaluation = assess(agent, job, settings.final_episodes, settings.final_seed)
    evaluation = {"steps_trained": run.manifest().get("steps"), "policy": "last", **evaluation}
    run.write(EVALUATION, json.dumps(evaluation, indent=2) + "\n")
    if settings.video_episodes:
        film(job.env, agent, settings.video_episodes, settings.final_seed, run.vacate(VIDEO))
        logger.video(run.folder / VIDEO)
    run.note(finished=True)
    print(f"{report(job.env.definition, evaluation)}\nrun          {run.folder}")


def start(values: dict[str, Any], overrides: list[str], command: str) -> tuple[str, float]:
    """Do what a composed config asks for: a new run, or the rest of one. See ``open_session``.

    Returns ``done``, ``done before``, ``paused`` or ``stopped``; and the objective of a run that is
    done, NaN of another.
    """
    until, objective = values["until"], values["objective"]
    with open_session(values, overrides, command) as session:
        job, run = session.job, session.run
        if run.manifest().get("finished"):
            return "done before", _achieved(run, objective)
        with closing(Logger(job, run.config(), run.folder, session.steps)) as logger:
            if session.steps == job.updates * job.buffer:
                end = "done"
            elif until is not None and until <= session.steps:
                run.note(stopped=True)
                end = "paused"
            else:
                end = train(job, run, logger, session.state, session.weights, until)
            if end == "done":
                try:
                    finish(job, run, logger)
                    return end, _achieved(run, objective)
                except KeyboardInterrupt:
                    run.note(stopped=True)
                    end = "stopped"
            print(f"{end}; go on with: {command} {shlex.quote(f'resume={run.folder}')}")
            return end, math.nan


def _achieved(run: Run, objective: str) -> float:
    """A number of a finished run's evaluation."""
    return float(read_json(run.folder / EVALUATION)[objective])
