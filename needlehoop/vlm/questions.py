"""The questions on cameras: which suit the task's parts, and how camera sets rank.

Rankings are put together from samples of one list, or from groups of a list too long for one
question.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator
from scipy.stats import kendalltau

from needlehoop.config.strict import Range
from needlehoop.envs.settings import Settings
from needlehoop.runs.files import csv_text
from needlehoop.scene.cameras import parse_cameras
from needlehoop.scene.image_size import extent
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import Samples
from needlehoop.vlm.conversation import Conversation, Subtasks, choice, choices, ranking
from needlehoop.vlm.description import bullets, fill, questioned
from needlehoop.vlm.messages import Part, Png

Ranked = dict[str, Any]
"""An answer, as ``conversation.ranking``: ``places``, best first, and how ``sure`` they are."""

_SEED = 0


def _different(names: Any) -> Any:
    if len(set(names)) < max(2, len(names)):
        raise ValueError(f"{[*names]} must be two or more, all different")
    return names


_DIFFERENT = AfterValidator(_different)


@dataclass(frozen=True)
class Questions:
    """Values in ``conf/vlm_question.yaml``, which explains them."""

    shown: Annotated[tuple[str, ...], _DIFFERENT]
    layouts: Annotated[Mapping[str, str], _DIFFERENT]


@dataclass(frozen=True)
class Lists:
    """Values in ``conf/vlm_rank.yaml``, which explains them."""

    lists: tuple[Annotated[tuple[str, ...], _DIFFERENT], ...]
    samples: Samples
    afresh: bool
    sets: tuple[Annotated[tuple[str, ...], _DIFFERENT], ...] = ()
    group: Annotated[int, Range(2, 20)] = 5
    rounds: Annotated[int, Range(1, 100)] = 4

    def check(self, settings: Settings, shown: Sequence[str]) -> None:
        """``ValueError``: a camera that the questions do not show."""
        key, valid = ("sets", settings.renderings) if self.sets else ("lists", shown)
        for name in chain(*(self.sets or self.lists)):
            try:
                parse_cameras(name.split("+"), settings.views, valid)
            except ValueError as error:
                raise ValueError(f"{key}: {name}: {error}") from error

    def asked(self) -> Iterator[tuple[int, int, Sequence[str]]]:
        """Each question in turn: (list number, sample number, camera sets); with ``sets`` the
        second is a group's number. Numbers start at 1."""
        for number, sets in enumerate(self.sets, 1):
            for part, dealt in enumerate(deal(sets, self.group, self.rounds), 1):
                yield number, part, dealt
        for sample in () if self.sets else range(1, self.samples + 1):
            for number, sets in enumerate(self.lists, 1):
                yield number, sample, sets


def question(
    conversation: Conversation, settings: Settings, album: Album, questions: Questions
) -> dict[str, Any]:
    """Put all questions, in one new conversation; answers by question, as plain values."""
    views, shown, task = list(settings.views), list(questions.shown), settings.definition
    cameras = [f"{rendering}_{view}" for rendering in shown for view in views]
    first, rest = cameras[: len(views)], cameras[len(views) :]
    text = fill(
        "subtasks",
        scene=description.scene(settings),
        cameras=description.cameras(settings, shown),
        stages=description.stages(settings),
        rendering=shown[0],
    )
    subtasks = conversation.ask([text, *album.show(first)], Subtasks)
    pictures = [*album.show(rest), *album.show_at_agents_size(cameras)]
    suits = conversation.ask([fill("suits"), *pictures], choices(views, shown))
    moments = {
        fact: conversation.ask([fill(fact, task)], choice(views, shown)).model_dump()
        for fact in ("goal", *questioned(task))
    }
    described = bullets(questions.layouts)
    layouts = _ranked(conversation, [*questions.layouts], "layouts", layouts=described)
    placements = {
        str(count): order(conversation, sets)
        for count in (1, 2)
        if len(sets := ["+".join(chosen) for chosen in combinations(first, count)]) > 1
    }
    return {
        "subtasks": subtasks.model_dump(),
        "suits": suits.model_dump(),
        **moments,
        "layouts": layouts["places"],
        "layouts_sure": layouts["sure"],
        "placements": placements,
    }


def narrowed(settings: Settings, sets: Sequence[str]) -> Settings:
    """Settings with the cameras of a list, and with their views and renderings alone."""
    used = {camera for name in sets for camera in name.split("+")}
    cameras = (f"{r}_{v}" for r in settings.renderings for v in settings.views)
    cams = tuple(camera for camera in cameras if camera in used)
    kinds, views = ({camera.partition("_")[part] for camera in cams} for part in (0, 2))
    return replace(
        settings,
        cams=cams,
        views={name: view for name, view in settings.views.items() if name in views},
        renderings={name: kind for name, kind in settings.renderings.items() if name in kinds},
    )


def opening(
    settings: Settings,
    album: Album,
    sets: Sequence[str],
    prompt_detail: str,
    scene: str,
) -> list[Part]:
    """The scene and the pictures of all cameras of a list, where nothing else was asked before.

    ``scene``: the text of ``description.scene``, passed in because it is slow to make.
    """
    shown, texts = narrowed(settings, sets), [scene]
    if prompt_detail != "nothing":
        texts.append(description.cameras(settings, [*shown.renderings]))
    texts.append(description.stages(settings, prompt_detail))
    album = album.renamed(description.stage_names(settings, prompt_detail))
    text = fill("rank_afresh", told="\n\n".join(texts), pixels=extent(settings.image_size))
    return [text, *album.show(shown.cams), *album.show_at_agents_size(shown.cams)]


def order(conversation: Conversation, sets: Sequence[str], before: Sequence[Part] = ()) -> Ranked:
    """Rank sets, after ``before`` or after all that was answered."""
    basis = "saw in the pictures" if before else "saw in the pictures and what you answered so far"
    sentence = f"Use what you {basis}."
    return _ranked(conversation, sets, "rank", before, basis=sentence)


def order_pictures(
    conversation: Conversation, pictures: Mapping[str, Png], about: str, names: Sequence[str]
) -> Ranked:
    """Rank cameras by a picture of each, by name; ``about``: what the task is; may be empty."""
    shown: list[Part] = [part for name in names for part in (f"{name}:", pictures[name])]
    task = about or "You are not told what the task is."
    return _ranked(conversation, names, "rank_pictures", shown, told=task)


def _ranked(
    conversation: Conversation,
    names: Sequence[str],
    prompt: str,
    before: Sequence[Part] = (),
    **values: str,
) -> Ranked:
    """A ranking of names, asked for with a prompt; errors as in ``Conversation.ask``."""
    sure, listed = fill("sure", pairs=len(names) - 1), "\n".join(f"- {name}" for name in names)
    text = fill(prompt, sure=sure, combinations=listed, cameras=listed, **values)
    return conversation.ask([*before, text], ranking(names)).model_dump()


def of_samples(names: Sequence[str], answers: Sequence[Ranked]) -> dict[str, Any]:
    """Several rankings of one list, its ``combinations``, and how far they agree.

    By sample: ``rankings``, each the names as ``name`` and ``reason``, best first, and ``sure``.
    """
    ranked = [answer["places"] for answer in answers]
    return {
        "combinations": list(names),
        "rankings": ranked,
        "sure": [answer["sure"] for answer in answers],
        "agreement": _agreement([[entry["name"] for entry in places] for places in ranked]),
    }


def of_groups(
    names: Sequence[str], size: int, rounds: int, answers: Sequence[Ranked]
) -> dict[str, Any]:
    """One ranking of a list of any length, from those of the groups of ``deal``.

    Each answer says for every two of its names which is better; 0.5 is a tie. Bradley-Terry
    strengths are fitted to all of these. Beside what ``of_samples`` has are the ``scheme``, the
    ``strengths`` by name, and the ``questions`` as asked and answered.
    """
    scores = strengths(names, answers)
    order = sorted(names, key=lambda name: (-scores[name], names.index(name)))
    # The first answer's reason stays.
    places = [place for answer in reversed(answers) for place in answer["places"]]
    reasons = {place["name"]: place["reason"] for place in places}
    whole = {
        "places": [{"name": name, "reason": reasons[name]} for name in order],
        "sure": [round(scores[a] / (scores[a] + scores[b]), 4) for a, b in pairwise(order)],
    }
    pairs = zip(deal(names, size, rounds), answers, strict=True)
    return {
        **of_samples(names, [whole]),
        "scheme": {"groups_of": size, "rounds": rounds, "seed": _SEED, "fit": "Bradley-Terry"},
        "strengths": scores,
        "questions": [{"sets": dealt, **answer} for dealt, answer in pairs],
    }


def deal(names: Sequence[str], size: int, rounds: int) -> list[list[str]]:
    """Groups of at most ``size``, as even as can be: each name is in one of every round."""
    if len(names) <= size:
        return [list(names)]
    draw, count = random.Random(_SEED), -(-len(names) // size)
    groups = []
    for _ in range(rounds):
        shuffled = draw.sample(list(names), len(names))
        groups += [shuffled[first::count] for first in range(count)]
    return groups


def strengths(names: Sequence[str], answers: Sequence[Ranked]) -> dict[str, float]:
    """Bradley-Terry strengths, of mean 1, by name; equal for names that nothing tells apart.

    Each name also has one tie with an average one. Without it a name that always wins would have
    no finite strength.
    """
    place = {name: number for number, name in enumerate(names)}
    wins = np.zeros((len(names), len(names)))
    for answer in answers:
        order = [place[entry["name"]] for entry in answer["places"]]
        for first, second in combinations(range(len(order)), 2):
            tied = all(sure == 0.5 for sure in answer["sure"][first:second])
            wins[order[first], order[second]] += 0.5 if tied else 1.0
            wins[order[second], order[first]] += 0.5 if tied else 0.0
    strength = np.ones(len(names))
    for _ in range(500):
        met = (wins + wins.T) / (strength[:, None] + strength)
        strength = (0.5 + wins.sum(1)) / (1 / (strength + 1.0) + met.sum(1))
        strength /= strength.mean()
    return {name: round(float(strength[number]), 6) for name, number in place.items()}


def _agreement(orders: Sequence[Sequence[str]]) -> dict[str, float] | None:
    """How far orders of one list, the best first, agree; ``None`` for fewer than two.

    ``tau_b``: Kendall's, mean over all pairs. ``same_top``: share with the commonest first place.
    """
    if len(orders) < 2:
        return None
    places = [[order.index(name) for name in orders[0]] for order in orders]
    taus = [float(kendalltau(a, b).statistic) for a, b in combinations(places, 2)]
    top = Counter(order[0] for order in orders).most_common(1)[0][1]
    return {"tau_b": sum(taus) / len(taus), "same_top": top / len(orders)}


def rankings_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``sample``, ``place`` (all from 1), ``cameras``, ``sure``, ``reason``.

    ``sure``: the stated probability that the set is better than the next; empty for the last.
    """
    rows = []
    for number, ranked in enumerate(lists, 1):
        samples = zip(ranked["rankings"], ranked["sure"], strict=True)
        for sample, (entries, chances) in enumerate(samples, 1):
            for place, (entry, sure) in enumerate(zip(entries, (*chances, ""), strict=True), 1):
                rows.append((number, sample, place, entry["name"], sure, entry["reason"]))
    return csv_text(("list", "sample", "place", "cameras", "sure", "reason"), rows)


def agreement_csv(lists: Sequence[Mapping[str, Any]]) -> str:
    """``list``, ``samples``, ``tau_b``, ``same_top``; empty cells where there is one sample."""
    rows = []
    for number, ranked in enumerate(lists, 1):
        agreed = ranked["agreement"] or {"tau_b": "", "same_top": ""}
        rows.append((number, len(ranked["rankings"]), agreed["tau_b"], agreed["same_top"]))
    return csv_text(("list", "samples", "tau_b", "same_top"), rows)
