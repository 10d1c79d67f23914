"""A training job: everything ``python train.py`` needs to know, as frozen dataclasses."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import torch

from needlehoop import rewards
from needlehoop.config import strict
from needlehoop.config.strict import Count, Names, Number, OneOf, Range, Seed, check_names
from needlehoop.envs.settings import Settings, import_task, with_task
from needlehoop.learning.algorithm_config import AlgorithmConfig, config_of
from needlehoop.learning.encoder import EncoderConfig, convolution_dtype
from needlehoop.learning.networks import HeadConfig, PolicySpec
from needlehoop.runs.files import (
    EXPERT,
    POLICIES,
    check_folder,
    check_name,
    labelled,
    reward_name,
    seen,
)

Steps = Annotated[int, Range(1, 10**15)]

_FEWEST = 20
"""Environments of a process, at least: fewer cost more than they bring."""


@dataclass(frozen=True)
class CollectorConfig:
    """Who fills the buffers; values in ``conf/collector``."""

    kind: Annotated[str, OneOf("single", "processes", "ray")]
    """``single``: this process. ``processes``: several of this machine. ``ray``: of several."""
    workers: Count | None
    """How many; ``None``: one a core, and at most one for 20 environments."""

    def parts(self, num_envs: int, cores: int) -> list[int]:
        """Environments of each worker."""
        most = max(1, min(cores, num_envs // _FEWEST))
        count = 1 if self.kind == "single" else self.workers or most
        return [num_envs // count + (i < num_envs % count) for i in range(count)]


@dataclass(frozen=True)
class Evaluation:
    """Deterministic evaluation; its episodes are none that training sees."""

    every: Number
    """Buffers between evaluations; 0: none on the way."""
    episodes: Count
    """Episodes of each."""
    final_episodes: Count
    """Episodes of the one at the end."""
    video_episodes: Number
    """Episodes in the video at the end; 0: no video."""
    seed: Seed

    @property
    def final_seed(self) -> int:
        """Of the episodes at the end, and of the film."""
        return self.seed + 1


@dataclass(frozen=True)
class WandbConfig:
    """Where Weights & Biases shows a run."""

    project: str
    entity: str | None
    mode: Annotated[str, OneOf("auto", "online", "offline", "disabled")]
    """``auto``: online where there is a login, offline elsewhere."""


@dataclass(frozen=True)
class Job:
    """Values in ``conf/config.yaml`` and the groups it names."""

    env: Settings
    algo: AlgorithmConfig
    encoder: EncoderConfig
    logger: Names
    """Where the run is shown; its own CSV files are always written."""
    wandb: WandbConfig
    evaluation: Evaluation
    results: str
    """Folder of all studies."""
    study: str
    steps: Steps
    """Environment steps, over all environments; the whole buffers among them are learnt from."""
    device: str
    """Of the learner: ``auto`` is ``cuda`` where there is one."""
    precision: str
    checkpoint_every: Count
    """Buffers between checkpoints."""
    collector: CollectorConfig = CollectorConfig("single", None)
    """By default that of runs from before there was a choice."""
    init: str | None = None
    """Folder of the run whose agent this one begins with."""
    weights: Annotated[str, OneOf("float32", "bfloat16")] = "float32"
    """What the files of policies keep their numbers in."""
    label: str | None = None
    """Tells the run's folder from those of other settings; a sweep makes it of what differs."""
    keep: Annotated[str, OneOf(*POLICIES, "both")] = "both"
    """Which policies have a file: the ``last``, the ``best`` of the evaluations on the way, or
    ``both``."""

    def __post_init__(self) -> None:
        check_names("logger", self.logger, ("csv", "tensorboard", "wandb"))
        told = self.algo.network.told
        if told is not None:
            check_names("algo.network.told", told, self.env.definition.all_facts)
        if not self.env.cams and not self.env.obs.signals:
            raise ValueError(
                "cams: an agent needs at least one camera, such as cams=dep_front,seg_side"
                " (or obs=signals, which needs none); choose from"
                f" {', '.join(self.env.renderings)} with {', '.join(self.env.views)}"
            )
        if self.env.cams:
            self.encoder.check_fit(self.env.image_size)
        least = self.env.num_envs * self.algo.horizon
        if self.buffer % least:
            raise ValueError(
                f"algo.buffer: {self.buffer} is not a multiple of num_envs * algo.horizon = {least}"
            )
        if self.updates < 1:
            raise ValueError(
                f"steps: {self.steps} is less than one buffer of {self.buffer} steps (algo.buffer,"
                f" or num_envs={self.env.num_envs} × algo.horizon={self.algo.horizon})"
            )
        if self.env.seed in (self.evaluation.seed, self.evaluation.final_seed):
            raise ValueError(
                f"evaluation.seed: {self.evaluation.seed} and the next are of evaluations, and"
                f" {self.env.seed} is the training's; choose another"
            )
        if (self.collector.workers or 1) > self.env.num_envs:
            raise ValueError(
                f"collector.workers: {self.collector.workers} is more than"
                f" num_envs={self.env.num_envs}"
            )
        if self.collector.kind == "ray" and self.env.num_envs % (self.collector.workers or 1):
            raise ValueError(
                f"collector.workers: {self.collector.workers} workers of Ray share"
                f" num_envs={self.env.num_envs} equally; choose a divisor"
            )
        check_folder("results", self.results)
        if self.keep == "best" and not 0 < self.evaluation.every <= self.updates:
            raise ValueError(
                f"keep: there is no best without an evaluation on the way; evaluation.every="
                f"{self.evaluation.every} is none in {self.updates} buffers"
            )
        for key in ("study", "reward_name", *(["label"] if self.label is not None else [])):
            check_name(key, getattr(self, key))
        convolution_dtype(self.precision, self.torch_device)

    @property
    def network(self) -> HeadConfig:
        """The agent's trunk and heads, with the facts that its value function is told."""
        own = self.algo.network
        return own if own.told is not None else replace(own, told=self.env.definition.critic)

    @property
    def spec(self) -> PolicySpec:
        """What its policy sees and does."""
        env, rules = self.env, self.env.episode
        seen = (env.image_channels, env.image_size, env.vectors)
        made = (self.encoder, self.network, rules.control, rules.action_size, self.precision)
        return PolicySpec(*seen, *made)

    @property
    def buffer(self) -> int:
        """Steps per buffer, over all environments."""
        return self.algo.steps(self.env.num_envs)

    @property
    def updates(self) -> int:
        """Buffers to learn from."""
        return self.steps // self.buffer

    @property
    def reward_name(self) -> str:
        """What the run's folder calls the reward, or who taught the run."""
        return EXPERT if self.algo.imitates else reward_name(self.env.reward)

    @property
    def place(self) -> str:
        """The run's folder below ``results``: study, cameras, reward and label, seed."""
        cameras = seen(self.env.cams, self.env.obs.signals)
        taught = labelled(self.reward_name, self.label)
        return f"{self.study}/{cameras}/{taught}/seed{self.env.seed}"

    @property
    def torch_device(self) -> torch.device:
        """Where the learner runs."""
        return pick_device(self.device)


def pick_device(name: str) -> torch.device:
    """``auto``, ``cpu``, ``cuda`` or ``cuda:<k>`` as a device.

    Raises ``ValueError`` for one that is not on this machine.
    """
    gpus = [f"cuda:{i}" for i in range(torch.cuda.device_count())]
    check_names("device", [name], ("auto", "cpu", *(["cuda", *gpus] if gpus else [])))
    return torch.device(("cuda" if gpus else "cpu") if name == "auto" else name)


def typed_job(values: Mapping[str, Any]) -> Job:
    """What somebody typed, composed, as a job; ``ValueError`` for a wrong value, with its key."""
    import_task(values)
    found = checked_job(values)
    return replace(found, env=replace(found.env, reward=rewards.with_function(found.env.reward)))


def checked_job(values: Mapping[str, Any]) -> Job:
    """The same, with a reward that can run no code; imports no task."""
    own, environment = (
        {name: values[name] for name in kind.__dataclass_fields__ if name in values}
        for kind in (Job, Settings)
    )
    own |= {**_loggers(own), "algo": config_of(values.get("algo"))}
    try:
        return strict.structure({**own, "env": with_task(environment)}, Job)
    except ValueError as error:
        # The environment's keys are below ``env`` in a job, and not in the YAML.
        raise ValueError(re.sub(r"(^|; )env(\.|: )", r"\1", str(error))) from error


def _loggers(values: Mapping[str, Any]) -> dict[str, Any]:
    """The loggers of a run of before there could be several: one, with wandb's settings in it."""
    given = values.get("logger")
    if not isinstance(given, Mapping):
        return {}
    settings = {key: value for key, value in given.items() if key != "kind"}
    return {"logger": [given.get("kind")], "wandb": settings}
