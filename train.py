"""Train an agent to thread the needle: ``python train.py cams=dep_front,seg_side reward=human``.

``train`` is the method: collect a buffer, learn from it, write down what came of it.
``python train.py --help`` lists the settings.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from tqdm import tqdm

from needlehoop import config, rewards, sweep
from needlehoop.learning.evaluate import assess, evaluate, film, load_agent, report
from needlehoop.learning.job import Job
from needlehoop.learning.learner import Learner
from needlehoop.learning.loggers import Logger, build_logger
from needlehoop.learning.metrics import episode_columns, peak_memory
from needlehoop.runs.files import EVALUATIONS, METRICS, VIDEO
from needlehoop.runs.interruption import Interruption
from needlehoop.runs.run import Run
from needlehoop.session import open_session


def train(job: Job, run: Run, logger: Logger, state: dict[str, Any] | None = None) -> bool:
    """Train until the job's steps are done, or until a signal asks to stop.

    Args:
        job: what to train.
        run: where its files go.
        logger: where else.
        state: the checkpoint to go on from.

    Returns:
        Whether the steps are done.
    """
    learner = Learner(job, state and state["learner"])
    began = time.perf_counter() - (state["wall_time"] if state else 0.0)
    shown = {"return": math.nan, "success": math.nan}
    bar = tqdm(total=job.updates * job.buffer, initial=learner.steps, unit="step", unit_scale=True)
    with bar, Interruption() as interruption:
        for buffer, losses in learner:
            update = learner.ppo.done_updates
            at = {"update": update, "step": learner.steps, "wall_time": time.perf_counter() - began}
            rate = job.buffer / (losses["seconds_collect"] + losses["seconds_update"])
            row = {**at, "steps_per_second": rate, **episode_columns(buffer), **losses}
            row["memory_gb"] = peak_memory()
            run.append(METRICS, row)
            logger.log("train", row)
            shown |= {name: row[name] for name in shown if not math.isnan(row[name])}
            bar.set_postfix({name: f"{value:.2f}" for name, value in shown.items()})
            bar.update(job.buffer)

            if job.evaluation.every and update % job.evaluation.every == 0:
                own = replace(job.env, seed=job.evaluation.seed)
                outcome = evaluate(own, learner.agent, job.evaluation.episodes)
                evaluation = {**at, **outcome.summary()}
                run.append(EVALUATIONS, evaluation)
                logger.log("evaluation", evaluation)

            if interruption.asked or update % job.checkpoint_every == 0 or update == job.updates:
                wall = time.perf_counter() - began
                run.save({"learner": learner.state_dict(), "update": update, "wall_time": wall})
                run.note(steps=learner.steps, wall_time=round(wall, 1), stopped=interruption.asked)
            if interruption.asked:
                break
    return learner.ppo.done_updates == job.updates


def finish(job: Job, run: Run, logger: Logger) -> None:
    """Evaluate the trained agent at length, film it, and print what the run gave."""
    agent = load_agent(run, job, job.torch_device)
    own = job.evaluation
    found = assess(run, agent, job, own.final_episodes, own.seed + 1)
    if own.video_episodes:
        film(job.env, agent, own.video_episodes, own.seed + 1, run.vacate(VIDEO))
        logger.video(run.folder / VIDEO)
    run.note(finished=True)
    print(f"\n{report(found)}\nrun          {run.folder}")


def start(values: dict[str, Any], overrides: list[str]) -> str:
    """Do what a composed config asks for: a new run, or the rest of one.

    Returns:
        ``done``, ``done before`` or ``stopped``.
    """
    session = open_session(values, overrides)
    job, run = session.job, session.run
    if session.is_finished:
        return "done before"
    logger = build_logger(job.logger, job.place, session.values, run.folder)
    try:
        if session.is_trained or train(job, run, logger, session.state):
            finish(job, run, logger)
            return "done"
        print(f"stopped; go on with: python train.py resume={run.folder}")
        return "stopped"
    finally:
        logger.close()


@hydra.main(config_path=str(config.CONF), config_name="config", version_base="1.3")
def main(composed: DictConfig) -> None:
    """One run; under ``-m`` called once for each."""
    values = config.plain(composed)
    own = HydraConfig.get()
    overrides = list(own.overrides.task)
    if own.mode == RunMode.MULTIRUN:
        values["engine"]["threads"] = values["engine"]["threads"] or sweep.threads(own.launcher)
        if values["existing"] == "auto":
            values["existing"] = "resume"
        note = sweep.identity(values, overrides)
        sweep.attempt(lambda: start(values, overrides), Path(own.runtime.output_dir), note)
        return
    try:
        start(values, overrides)
    except (ValueError, OSError, rewards.RewardError) as error:
        sys.exit(f"train.py: {error}")


if __name__ == "__main__":
    sys.argv[1:] = config.in_brackets(sys.argv[1:])
    config.register()
    if not any(word.startswith(("-", "+experiment=")) for word in sys.argv[1:]):
        try:
            # Hydra's own message for a bad override has ten lines and no list of keys.
            config.compose(sys.argv[1:], "config")
        except ValueError as error:
            sys.exit(f"train.py: {error}")
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("train.py: stopped; the same command goes on with a sweep")
