"""What engine=warp gives on a device: whether it is right, and how fast.

    python benchmarks/gpu.py cuda 256 1024 4096        # a GPU: about ten minutes
    python benchmarks/gpu.py cpu 8                     # Warp's CPU device: a check, no speed

In this order: the CPU engine's images and facts beside it, episodes of the expert, steps per second
of the environment by its parts at each number of environments, and of a training at the last one.
On a GPU then a whole training from ``dep_front,seg_side``, evaluated each minute.
"""

import sys
import time
from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import torch

from needlehoop.config import composing
from needlehoop.envs.build import build
from needlehoop.envs.controllers import controller, outcome_of
from needlehoop.envs.settings import Settings, compose_settings
from needlehoop.learning.evaluate import evaluate
from needlehoop.learning.job import typed_job
from needlehoop.learning.learner import Learner

CAMS = "cams=[dep_front,seg_side]"


def settings(device: str, envs: int) -> Settings:
    return compose_settings([CAMS, "engine=warp", f"engine.device={device}", f"num_envs={envs}"])


def wait(device: str) -> float:
    """The time, once all work that was begun is done."""
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def beside_the_cpu(device: str) -> str:
    """The same episodes on both engines, under the smooth expert's actions."""
    ours = build(settings(device, 16))
    reference = build(compose_settings([CAMS, "num_envs=16"]))
    act = controller("smooth", reference.settings)
    warp, cpu, apart, facts, pixels = ours.reset(), reference.reset(), [], [], []
    for _ in range(20):
        images, same = ours.images(), reference.images()
        pixels += [float((images[name].cpu() != same[name]).float().mean()) for name in images]
        action = act(cpu.signals)
        warp, cpu = ours.step(action.to(ours.device)), reference.step(action)
        tips = warp.signals.needle_tip.cpu() - cpu.signals.needle_tip
        apart.append(float(tips.norm(dim=-1).median()))
        facts += [bool((warp.facts[name].cpu() == cpu.facts[name]).all()) for name in warp.facts]
    return (
        f"20 steps of 16 episodes: {max(pixels):.2%} of an image's values differ at most, the tip"
        f" by {1e6 * max(apart):.2f} um (median), facts are equal in {sum(facts)} of {len(facts)}"
    )


def parts(device: str, envs: int, steps: int) -> str:
    """Steps per second of the environment, and where a step's time goes."""
    simulation = build(settings(device, envs))
    moment, act = simulation.reset(stagger=True), controller("smooth", simulation.settings)
    spent: dict[str, float] = defaultdict(float)
    for step in range(steps + 2):
        if step == 2:
            spent.clear()
        marks = [("", wait(device))]

        def mark(name: str, to: list = marks) -> None:
            to.append((name, wait(device)))

        control = simulation.act(act(moment.signals))
        mark("act")
        simulation.engine.step(control)
        mark("physics")
        moment = simulation.observe()
        mark("facts and reward")
        simulation.images()
        mark("images")
        over = moment.terminated | moment.truncated
        if bool(over.any()):
            moment = simulation.reset(over)
        mark("episodes that begin")
        for (_, begin), (name, end) in pairwise(marks):
            spent[name] += end - begin
    total = sum(spent.values())
    shares = ", ".join(f"{name} {spent[name] / total:.0%}" for name in spent)
    return f"{envs} environments: {envs * steps / total:,.0f} steps/s ({shares})"


def learner_of(device: str, envs: int, *words: str) -> Learner:
    defaults = [CAMS, "+experiment=gpu", f"engine.device={device}", f"device={device}"]
    job = typed_job(composing.compose([*defaults, f"num_envs={envs}", *words], "job"))
    return Learner(replace(job, steps=max(job.steps, 3 * job.buffer)))


def training(device: str, envs: int) -> str:
    """Steps per second of a training, learning included; the first buffer warms up."""
    learner = learner_of(device, envs)
    buffers = iter(learner)
    next(buffers)
    began = wait(device)
    next(buffers)
    rate = learner.job.buffer / (wait(device) - began)
    return f"training at {envs} environments: {rate:,.0f} steps/s"


def until_it_threads(envs: int, minutes: float) -> None:
    """Train, evaluate each minute, and say when 95 of 100 episodes thread."""
    learner, began, last = learner_of("cuda", envs), time.perf_counter(), 0.0
    job = learner.job
    for _ in learner:
        passed = (time.perf_counter() - began) / 60
        if passed < last + 1 and learner.steps < job.steps:
            continue
        last = passed
        env = replace(job.env, seed=job.evaluation.seed)
        share = float(evaluate(env, learner.agent, 100).success.double().mean())
        print(f"{passed:.1f} minutes, {learner.steps:,} steps: threads in {share:.0%}", flush=True)
        if share >= 0.95 or passed > minutes:
            return


def main(device: str, sizes: list[int]) -> None:
    print(beside_the_cpu(device), flush=True)
    simulation = build(settings(device, 16))
    summary = outcome_of(simulation, controller("expert", simulation.settings)).summary()
    print(f"the expert threads in {summary['success']:.0%} of 16 episodes", flush=True)
    for envs in sizes:
        print(parts(device, envs, 60 if device == "cuda" else 5), flush=True)
    print(training(device, sizes[-1]), flush=True)
    if device == "cuda":
        until_it_threads(sizes[-1], 6.0)


if __name__ == "__main__":
    main(sys.argv[1], [int(word) for word in sys.argv[2:]])
