"""The questions on cameras: which suit the task's parts, and how camera sets rank."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from typing import Annotated, Any

from needlehoop.config.strict import Range
from needlehoop.envs.settings import Settings
from needlehoop.scene.cameras import parse_cameras
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import Samples
from needlehoop.vlm.conversation import Conversation
from needlehoop.vlm.forms import Subtasks, choice, choices, ranking
from needlehoop.vlm.grouping import rank_groups
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.prompts import fill, questioned
from needlehoop.vlm.tables import agreement


@dataclass(frozen=True)
class Questions:
    """Values in ``conf/vlm_question.yaml``."""

    shown: tuple[str, ...]
    """Renderings to show and to choose from; the first question shows the first one alone."""
    layouts: Mapping[str, str]
    """Ways to place cameras, to be ranked: name and description."""

    def __post_init__(self) -> None:
        if len(self.shown) < 2 or len(set(self.shown)) < len(self.shown):
            raise ValueError(f"shown: {list(self.shown)} must be two or more different renderings")
        if len(self.layouts) < 2:
            raise ValueError("layouts: at least two are needed to rank them")

    def check(self, settings: Settings) -> None:
        """Raises ``ValueError`` for a rendering that the scene does not have."""
        for name in self.shown:
            if name not in settings.renderings:
                valid = ", ".join(settings.renderings)
                raise ValueError(f"shown: {name!r} is unknown; choose from {valid}")


@dataclass(frozen=True)
class Lists:
    """Values in ``conf/vlm_rank.yaml``."""

    lists: tuple[tuple[str, ...], ...]
    """Lists of camera sets, such as ``dep_front+seg_side``; each list is ranked by itself."""
    samples: Samples
    """Conversations in which the lists are ranked."""
    afresh: bool
    """Rank each list in a conversation of its own, not after the questions on cameras."""
    sets: tuple[tuple[str, ...], ...] = ()
    """In place of the lists: lists of any length, ranked a few sets at a time."""
    words: bool = True
    """Whether ``sets`` come with the places of their cameras in words."""
    group: Annotated[int, Range(2, 20)] = 5
    """Of ``sets``, how many one question asks about, at most."""
    rounds: Annotated[int, Range(1, 100)] = 4
    """In how many questions each of ``sets`` is asked about, where there are more."""

    def __post_init__(self) -> None:
        if not self.lists:
            raise ValueError("lists: there is nothing to rank")
        for key, sets in (
            *(("lists", sets) for sets in self.lists),
            *(("sets", sets) for sets in self.sets),
        ):
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


def question(
    conversation: Conversation, settings: Settings, album: Album, questions: Questions
) -> dict[str, Any]:
    """Put all questions, in one conversation; answers by question, as plain values.

    Args:
        conversation: a new one.
        settings: the scene.
        album: its pictures.
        questions: what to show and to offer.

    Raises:
        NoAnswerError: no usable answer to a question within its attempts.
        RefusalError: the model would not answer.
    """
    views, shown, task = list(settings.views), list(questions.shown), settings.definition
    of = {rendering: [f"{rendering}_{view}" for view in views] for rendering in shown}
    first, *others = of.values()
    opening = fill(
        "subtasks",
        scene=description.scene(settings),
        cameras=description.cameras(settings, shown),
        stages=description.stages(settings),
        rendering=shown[0],
    )
    subtasks = conversation.ask([opening, *album.show(first)], Subtasks)
    rest = [camera for cameras in others for camera in cameras]
    pictures = [*album.show(rest), *album.show_seen([*first, *rest])]
    suits = conversation.ask([fill("suits"), *pictures], choices(views, shown))
    goal = conversation.ask([fill("goal", task)], choice(views, shown))
    moments = {
        fact: conversation.ask([fill(fact, task)], choice(views, shown)).model_dump()
        for fact in questioned(task)
    }
    told, ways = description.bullets(questions.layouts), list(questions.layouts)
    layouts = conversation.ask(
        [fill("layouts", layouts=told, sure=_how_sure(ways))], ranking(ways)
    ).model_dump()
    placements = {
        str(count): _order(conversation, sets, [], _ANSWERED)
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


def rank(begin: Callable[[int], Conversation], lists: Lists) -> list[dict[str, Any]]:
    """Rank the lists in one or more conversations.

    Args:
        begin: gives the conversation of a sample (1, 2, …) in which ``question`` is done.
        lists: what to rank, and how often.

    Returns:
        For each list its camera sets (``combinations``); by sample, the rankings, each the sets as
        ``name`` and ``reason``, best first, and how ``sure`` each place is; how far they agree.

    Raises:
        NoAnswerError: no usable answer to a question within its attempts.
        RefusalError: the model would not answer.
    """
    samples = []
    for number in range(1, lists.samples + 1):
        conversation = begin(number)
        samples.append([_order(conversation, sets, [], _ANSWERED) for sets in lists.lists])
    return _by_list(lists, samples)


def rank_afresh(
    begin: Callable[[int, int], Conversation],
    settings: Settings,
    album: Album,
    lists: Lists,
    told: str,
) -> list[dict[str, Any]]:
    """Rank each list in a conversation of its own, in which nothing else was asked.

    Args:
        begin: gives a new conversation, for a list and a sample that count from 1.
        settings: the scene.
        album: its pictures.
        lists: what to rank, and how often.
        told: how much is told: ``full``, ``names`` or ``nothing``.

    Returns:
        As ``rank``; errors too.
    """
    openings = [_afresh(settings, album, sets, told) for sets in lists.lists]
    samples = [
        [
            _order(begin(number, sample), sets, opening, _SHOWN)
            for number, (sets, opening) in enumerate(zip(lists.lists, openings, strict=True), 1)
        ]
        for sample in range(1, lists.samples + 1)
    ]
    return _by_list(lists, samples)


_SHOWN = "Use what you saw in the pictures."
_ANSWERED = "Use what you saw in the pictures and what you answered so far."


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


def rank_sets(
    begin: Callable[[int, int], Conversation],
    settings: Settings,
    album: Album,
    lists: Lists,
    told: str,
) -> list[dict[str, Any]]:
    """Rank ``lists.sets``, a few of a list at a time; each as ``rank_groups``.

    Each question shows the cameras of its sets alone, and says where these stand if ``words``.
    ``begin`` gives a new conversation, for a list and a question that count from 1.
    """

    def asked(number: int, place: int, sets: Sequence[str]) -> dict[str, Any]:
        own = seen_by(settings, sets)[1]
        opening = _afresh(own, album, sets, told, lists.words)
        return _order(begin(number, place), sets, opening, _SHOWN)

    return [
        rank_groups(partial(asked, number), sets, lists)
        for number, sets in enumerate(lists.sets, 1)
    ]


def rank_pictures(
    begin: Callable[[int], Conversation], pictures: Mapping[str, Png], about: str, lists: Lists
) -> dict[str, Any]:
    """Rank cameras by a picture of each, a few at a time; as ``rank_groups``.

    Args:
        begin: gives a new conversation, for a question that counts from 1.
        pictures: by the camera's name.
        about: what the task is; may be empty.
        lists: ``group`` and ``rounds``.
    """

    def ask(number: int, names: Sequence[str]) -> dict[str, Any]:
        shown: list[Part] = [part for name in names for part in (f"{name}:", pictures[name])]
        told = about or "You are not told what the task is."
        listed = "\n".join(f"- {name}" for name in names)
        prompt = fill("rank_pictures", told=told, cameras=listed, sure=_how_sure(names))
        return begin(number).ask([*shown, prompt], ranking(names)).model_dump()

    return rank_groups(ask, tuple(pictures), lists)


def _afresh(
    settings: Settings, album: Album, sets: Sequence[str], told: str, words: bool = True
) -> list[Part]:
    """The scene and the pictures of all cameras of a list."""
    cameras, _ = seen_by(settings, sets)
    kinds = list(dict.fromkeys(camera.partition("_")[0] for camera in cameras))
    said = [
        description.scene(settings, told),
        *([] if told == "nothing" or not words else [description.cameras(settings, kinds)]),
        description.stages(settings, told),
    ]
    names = description.stage_names(settings, told)
    opening = fill("rank_afresh", told="\n\n".join(said), pixels=settings.image_size)
    return [opening, *album.show(cameras, names=names), *album.show_seen(cameras, names)]


def _order(
    conversation: Conversation, sets: Sequence[str], before: Sequence[Part], basis: str
) -> dict[str, Any]:
    """The sets as ``places``, and how ``sure`` they are."""
    listed = "\n".join(f"- {name}" for name in sets)
    prompt = fill("rank", combinations=listed, basis=basis, sure=_how_sure(sets))
    return conversation.ask([*before, prompt], ranking(sets)).model_dump()


def _how_sure(ranked: Sequence[str]) -> str:
    return fill("sure", pairs=len(ranked) - 1)


def _by_list(lists: Lists, samples: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    return [
        {
            "combinations": list(sets),
            "rankings": [answer["places"] for answer in answers],
            "sure": [answer["sure"] for answer in answers],
            "agreement": agreement(
                [[entry["name"] for entry in answer["places"]] for answer in answers]
            ),
        }
        for sets, *answers in zip(lists.lists, *samples, strict=True)
    ]
