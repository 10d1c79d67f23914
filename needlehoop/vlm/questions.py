"""The questions on cameras: which suit the task's parts, and how camera sets rank."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import Annotated, Any

from needlehoop.config.strict import Range, check_names
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import parse_cameras
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import Samples
from needlehoop.vlm.conversation import Conversation, Subtasks, choice, choices, ranking
from needlehoop.vlm.description import fill, questioned
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.rankings import Ranked, deal


@dataclass(frozen=True)
class Questions:
    """Values in ``conf/vlm_question.yaml``, which explains them."""

    shown: tuple[str, ...]
    layouts: Mapping[str, str]

    def __post_init__(self) -> None:
        if len(self.shown) < 2 or len(set(self.shown)) < len(self.shown):
            raise ValueError(f"shown: {list(self.shown)} must be two or more different renderings")
        if len(self.layouts) < 2:
            raise ValueError("layouts: at least two are needed to rank them")

    def check(self, settings: Settings) -> None:
        """Raises ``ValueError`` for a rendering that the scene does not have."""
        check_names("shown", self.shown, tuple(settings.renderings))


@dataclass(frozen=True)
class Lists:
    """Values in ``conf/vlm_rank.yaml``, which explains them."""

    lists: tuple[tuple[str, ...], ...]
    samples: Samples
    afresh: bool
    sets: tuple[tuple[str, ...], ...] = ()
    """In place of ``lists``; unlike these, of any length."""
    words: bool = True
    group: Annotated[int, Range(2, 20)] = 5
    rounds: Annotated[int, Range(1, 100)] = 4

    def __post_init__(self) -> None:
        if not self.lists:
            raise ValueError("lists: there is nothing to rank")
        for key, lists in (("lists", self.lists), ("sets", self.sets)):
            for sets in lists:
                if len(sets) < 2 or len(set(sets)) < len(sets):
                    raise ValueError(f"{key}: {list(sets)} must be two or more different sets")

    def check(self, settings: Settings, shown: Sequence[str]) -> None:
        """Raises ``ValueError`` for a camera that the questions do not show."""
        key, valid = ("sets", settings.renderings) if self.sets else ("lists", shown)
        for name in chain(*(self.sets or self.lists)):
            try:
                parse_cameras(name.split("+"), settings.views, valid)
            except ValueError as error:
                raise ValueError(f"{key}: {name}: {error}") from error

    def asked(self) -> Iterator[tuple[int, int, Sequence[str]]]:
        """What is to be ranked, in the order of asking.

        The number of a list, that of a sample or (of ``sets``) a group, both from 1; and the
        camera sets.
        """
        for number, sets in enumerate(self.sets, 1):
            for part, dealt in enumerate(deal(sets, self.group, self.rounds), 1):
                yield number, part, dealt
        for sample in () if self.sets else range(1, self.samples + 1):
            for number, sets in enumerate(self.lists, 1):
                yield number, sample, sets


def question(
    conversation: Conversation, settings: Settings, album: Album, questions: Questions
) -> dict[str, Any]:
    """Put all questions, in one new conversation; answers by question, as plain values.

    Errors are as in ``Conversation.ask``.
    """
    views, shown, task = list(settings.views), list(questions.shown), settings.definition
    of = {rendering: [f"{rendering}_{view}" for view in views] for rendering in shown}
    first, *others = of.values()
    text = fill(
        "subtasks",
        scene=description.scene(settings),
        cameras=description.cameras(settings, shown),
        stages=description.stages(settings),
        rendering=shown[0],
    )
    subtasks = conversation.ask([text, *album.show(first)], Subtasks)
    rest = [camera for cameras in others for camera in cameras]
    pictures = [*album.show(rest), *album.show_seen([*first, *rest])]
    suits = conversation.ask([fill("suits"), *pictures], choices(views, shown))
    goal = conversation.ask([fill("goal", task)], choice(views, shown))
    moments = {
        fact: conversation.ask([fill(fact, task)], choice(views, shown)).model_dump()
        for fact in questioned(task)
    }
    told, ways = description.bullets(questions.layouts), list(questions.layouts)
    layouts = _ranked(conversation, ways, "layouts", layouts=told)
    placements = {
        str(count): order(conversation, sets)
        for count in (1, 2)
        if len(sets := ["+".join(chosen) for chosen in combinations(first, count)]) > 1
    }
    return {
        "subtasks": subtasks.model_dump(),
        "suits": suits.model_dump(),
        "goal": goal.model_dump(),
        **moments,
        "layouts": layouts["places"],
        "layouts_sure": layouts["sure"],
        "placements": placements,
    }


def seen_by(settings: Settings, sets: Sequence[str]) -> tuple[list[str], Settings]:
    """The cameras of a list, and settings with their views and renderings alone."""
    used = {camera for name in sets for camera in name.split("+")}
    cameras = [f"{r}_{v}" for r in settings.renderings for v in settings.views]
    cameras = [camera for camera in cameras if camera in used]
    kinds, views = ({camera.split("_")[part] for camera in cameras} for part in (0, 1))
    return cameras, replace(
        settings,
        cams=(),
        views={name: view for name, view in settings.views.items() if name in views},
        renderings={name: kind for name, kind in settings.renderings.items() if name in kinds},
    )


def opening(
    settings: Settings,
    album: Album,
    sets: Sequence[str],
    told: str,
    scene: str,
    words: bool = True,
) -> list[Part]:
    """The scene and the pictures of all cameras of a list, where nothing else was asked before.

    ``scene`` is as ``description.scene`` tells it, which takes a while with ``names``. ``words``:
    whether cameras come with their places in words.
    """
    cameras, _ = seen_by(settings, sets)
    kinds = list(dict.fromkeys(camera.partition("_")[0] for camera in cameras))
    said = [
        scene,
        *([] if told == "nothing" or not words else [description.cameras(settings, kinds)]),
        description.stages(settings, told),
    ]
    album = album.named(description.stage_names(settings, told))
    text = fill("rank_afresh", told="\n\n".join(said), pixels=settings.image_size)
    return [text, *album.show(cameras), *album.show_seen(cameras)]


def order(conversation: Conversation, sets: Sequence[str], before: Sequence[Part] = ()) -> Ranked:
    """Rank sets, after ``before`` or after all that was answered."""
    basis = "saw in the pictures" if before else "saw in the pictures and what you answered so far"
    said = f"Use what you {basis}."
    return _ranked(conversation, sets, "rank", before, combinations=_listed(sets), basis=said)


def order_pictures(
    conversation: Conversation, pictures: Mapping[str, Png], about: str, names: Sequence[str]
) -> Ranked:
    """Rank cameras by a picture of each, by name; ``about``: what the task is; may be empty."""
    shown: list[Part] = [part for name in names for part in (f"{name}:", pictures[name])]
    told = about or "You are not told what the task is."
    return _ranked(conversation, names, "rank_pictures", shown, told=told, cameras=_listed(names))


def _listed(names: Sequence[str]) -> str:
    return "\n".join(f"- {name}" for name in names)


def _ranked(
    conversation: Conversation,
    names: Sequence[str],
    prompt: str,
    before: Sequence[Part] = (),
    **values: str,
) -> Ranked:
    """A ranking of names, asked for with a prompt; errors as in ``Conversation.ask``."""
    text = fill(prompt, sure=fill("sure", pairs=len(names) - 1), **values)
    return conversation.ask([*before, text], ranking(names)).model_dump()
