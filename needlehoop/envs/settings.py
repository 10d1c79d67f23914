"""Everything that defines an environment, as frozen dataclasses; ``build`` makes one of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from needlehoop import rewards
from needlehoop.config import composing, strict
from needlehoop.config.strict import Names, OneOf, Range, Seed, check_names, shown
from needlehoop.disturbances.axes import RASTERISED, Disturb
from needlehoop.engines.contract import EngineConfig
from needlehoop.robot.psm import VARIANTS
from needlehoop.scene.cameras import Camera, Rendering, View, parse_cameras
from needlehoop.scene.image_size import ImageSize
from needlehoop.tasks import registry
from needlehoop.tasks.contract import Task
from needlehoop.tasks.layout import Episode, Layout
from needlehoop.tasks.registry import find


@dataclass(frozen=True)
class Observations:
    """What is reported beside the images."""

    proprio: bool
    """What the robot knows of itself: of the PSM joint positions, jaw and jaw command."""
    signals: bool
    """The whole state, for agents without cameras."""
    frame_stack: Annotated[int, Range(1, 64)]
    """Frames per image, the newest last."""
    privileged_facts: Names
    """Facts that one image need not show, in the order in which they are reported."""


def sources(task: Task, obs: Observations) -> dict[str, tuple[str, ...]]:
    """The signals of each observed vector, in the order in which an agent reads the vectors."""
    proprio, state = task.robot.proprio * obs.proprio, task.state * obs.signals
    names = {"proprio": proprio, "signals": state, "privileged_facts": obs.privileged_facts}
    return {name: signals for name, signals in names.items() if signals}


@dataclass(frozen=True)
class Settings:
    """An environment's settings; values in ``conf/env.yaml`` and the groups it names."""

    task: Layout
    episode: Episode
    reward: Mapping[str, Any]
    engine: EngineConfig
    psm: Annotated[str, OneOf(*VARIANTS)]
    cams: Names
    image_size: ImageSize
    quality: Annotated[int, Range(1, 16)]
    """1: what agents see. k > 1: k x k rays a pixel, shadows and highlights."""
    obs: Observations
    num_envs: Annotated[int, Range(1, 100_000)]
    seed: Seed
    views: Mapping[str, View]
    renderings: Mapping[str, Rendering]
    picture: View
    """Where pictures for people are taken from; not a camera that agents can choose."""
    task_dir: str | None = None
    """Folder of a task from outside the package."""
    disturb: Disturb = field(default_factory=Disturb)
    """None by default, as in runs in results/ from before there were any."""

    def __post_init__(self) -> None:
        check_names("obs.privileged_facts", self.obs.privileged_facts, self.definition.agent_facts)
        parse_cameras(self.cams, self.views, self.renderings)
        rewards.check(self.reward, self.definition)
        amounts = self.disturb.amounts
        if "robot.offset" in amounts and self.definition.robot.displaced is None:
            raise ValueError(
                f"disturb.robot.offset: the robot of {self.task.name} does not say how (displaced)"
            )
        is_traced = self.engine.renderer != "rasteriser" or self.quality > 1
        for key in RASTERISED if is_traced else ():
            if key in amounts:
                raise ValueError(
                    f"disturb.{key}: only engine.renderer=rasteriser with quality=1 draws it"
                )

    @property
    def definition(self) -> Task:
        return find(self.task.name)

    @property
    def period(self) -> float:
        """Simulated time between two actions, s."""
        return self.task.timestep * self.episode.substeps

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return parse_cameras(self.cams, self.views, self.renderings)

    @property
    def vectors(self) -> dict[str, int]:
        """Lengths of the observed vectors by name, in the order of ``sources``."""
        task = self.definition
        return {
            name: sum(task.signals[signal].size for signal in signals)
            for name, signals in sources(task, self.obs).items()
        }

    @property
    def image_channels(self) -> dict[str, int]:
        """Channels of an observed image, stacked frames included, by camera."""
        stacked = self.obs.frame_stack
        return {c.name: self.renderings[c.rendering].channels * stacked for c in self.cameras}


def compose_settings(overrides: Iterable[str] = ()) -> Settings:
    """Settings from ``conf/env.yaml`` and Hydra overrides.

    Raises ``ValueError`` for an unknown key, option or value; it lists the valid ones.
    """
    return settings_from(composing.compose(overrides, "env"))


def settings_from(values: Mapping[str, Any]) -> Settings:
    """Settings from a composed config that somebody typed; keys of other tools are ignored."""
    import_task(values, trust=True)
    settings = strict.as_type(with_task(values), Settings)
    return replace(settings, reward=rewards.with_function(settings.reward))


def import_task(values: Mapping[str, Any], trust: bool) -> None:
    """Import the task that a config names, if it is from elsewhere; see ``registry.add``.

    ``trust``: whether its code may run. What somebody typed is trusted; a run's files are only
    where the person says so. ``ValueError`` for a task from elsewhere without trust.
    """
    task = values.get("task")
    name = task.get("name") if isinstance(task, Mapping) else None
    folder = strict.structure(values.get("task_dir"), str | None, "task_dir")
    if not trust and registry.is_from_elsewhere(name, folder):
        origin = "an installed package" if folder is None else folder
        raise ValueError(
            f"task: the run's files name Python code, {shown(name)} of {shown(origin)}, which would"
            " be imported and run; add trust=true if you trust them"
        )
    registry.add(name, folder)


def with_task(values: Mapping[str, Any]) -> dict[str, Any]:
    """Composed values with the task's own dataclasses for ``task`` and ``episode``.

    A flat rendering that names no colours gets the task's.
    """
    fields = strict.structure(values["task"], Mapping[str, Any], "task")
    task = find(fields.get("name"))
    layout = strict.structure(fields, task.layout, "task")
    rules = strict.structure(values["episode"], task.rules, "episode")
    kind = Mapping[str, Mapping[str, Any]]
    renderings = strict.structure(values["renderings"], kind, "renderings")
    for name, rendering in renderings.items():
        if rendering.get("colour") == "flat" and not rendering.get("colours"):
            colours = {thing: flat.colour for thing, flat in task.paint.items()}
            renderings[name] = {**rendering, "colours": colours}
    return {**values, "task": layout, "episode": rules, "renderings": renderings}
