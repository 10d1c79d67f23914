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
from needlehoop.learning.algorithm_config import AlgorithmConfig, DaggerConfig, config_of
from needlehoop.learning.encoder import EncoderConfig, convolution_dtype
from needlehoop.learning.networks import PolicySpec
from needlehoop.runs.files import EXPERT, check_folder, check_name, labelled, reward_name, seen

Steps = Annotated[int, Range(1, 10**15)]


@dataclass(frozen=True)
class CollectorConfig:
    """Who fills the buffers; values in ``conf/collector``."""

    kind: Annotated[str, OneOf("single", "processes", "ray")]
    """``single``: this process. ``processes``: several of this machine. ``ray``: of several."""
    workers: Count | None
    """How many; ``None``: one a core, and at most one for 20 environments."""

    def parts(self, num_envs: int, cores: int) -> list[int]:
        """Environments of each worker."""
        # Fewer in a process cost more than they bring.
        most = max(1, min(cores, num_envs // 20))
        count = 1 if self.kind == "single" else min(self.workers or most, num_envs)
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
    """By default that of runs in results/ from before there was a choice."""
    init: str | None = None
    """Folder of the run whose agent this one begins with."""
    weights: Annotated[str, OneOf("float32", "bfloat16")] = "float32"
    """What the files of policies keep their numbers in."""
    label: str | None = None
    """Tells the run's folder from those of other settings; a sweep makes it of what differs."""

    def __post_init__(self) -> None:
        check_names("logger", self.logger, ("csv", "tensorboard", "wandb"))
        facts = self.algo.network.privileged_facts
        if facts is not None:
            check_names("algo.network.privileged_facts", facts, self.env.definition.all_facts)
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
        if self.collector.kind == "ray" and self.env.num_envs % (self.collector.workers or 1):
            raise ValueError(
                f"collector.workers: {self.collector.workers} workers of Ray share"
                f" num_envs={self.env.num_envs} equally; choose a divisor"
            )
        check_folder("results", self.results)
        for key in ("study", "reward_name", "label"):
            if getattr(self, key) is not None:
                check_name(key, getattr(self, key))
        convolution_dtype(self.precision, self.torch_device)

    @property
    def spec(self) -> PolicySpec:
        """What its policy sees and does."""
        env, rules, network = self.env, self.env.episode, self.algo.network
        if network.privileged_facts is None:
            network = replace(network, privileged_facts=env.definition.critic)
        return PolicySpec(
            env.image_channels,
            env.image_size,
            env.vectors,
            self.encoder,
            network,
            rules.control,
            rules.action_size,
            self.precision,
        )

    @property
    def buffer(self) -> int:
        """Steps per buffer, over all environments."""
        return self.algo.buffer or self.env.num_envs * self.algo.horizon

    @property
    def updates(self) -> int:
        """Buffers to learn from."""
        return self.steps // self.buffer

    @property
    def reward_name(self) -> str:
        """What the run's folder calls the reward, or who taught the run."""
        return EXPERT if isinstance(self.algo, DaggerConfig) else reward_name(self.env.reward)

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
    import_task(values, trust=True)
    job = checked_job(values)
    return replace(job, env=replace(job.env, reward=rewards.with_function(job.env.reward)))


def checked_job(values: Mapping[str, Any]) -> Job:
    """The same, with a reward that can run no code; imports no task."""
    fields, environment = (
        {name: values[name] for name in kind.__dataclass_fields__ if name in values}
        for kind in (Job, Settings)
    )
    fields["algo"] = config_of(values.get("algo"))
    if isinstance(former := fields.get("logger"), Mapping):
        # Runs in results/ from before there could be several have one, with wandb's settings in it.
        shown = {key: value for key, value in former.items() if key != "kind"}
        fields |= {"logger": [former["kind"]], "wandb": shown}
    try:
        return strict.structure({**fields, "env": with_task(environment)}, Job)
    except ValueError as error:
        # The environment's keys are below ``env`` in a job, and not in the YAML.
        raise ValueError(re.sub(r"(^|; )env(\.|: )", r"\1", str(error))) from error
