"""All that a model is asked: by one that answers anything in the right form."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from vlm_server import by_schema

from needlehoop.envs.settings import Settings
from needlehoop.vlm import description, moments
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import LiveConfig
from needlehoop.vlm.conversation import Conversation, Guess, ProgramAnswer, Verdict
from needlehoop.vlm.description import stages_of
from needlehoop.vlm.messages import Png, Reply, Request
from needlehoop.vlm.questions import Lists, Questions, opening, order, order_pictures, question
from needlehoop.vlm.record import Record
from needlehoop.vlm.writing import ProgramRules, Trained, guess_prompt, reward_prompt

QUESTIONS = Questions(("rgb", "dep", "seg"), {"one": "one camera", "two": "two cameras"})
LISTS = Lists((("rgb_default", "dep_front+seg_side"),), 1, False)
RULES = ProgramRules(0.0, 9.0, lambda _: Verdict(None, {}))
CONFIG = LiveConfig("gemini", "m", None, None, {}, 1.0, 1)


class Obliging:
    """Answers as told, then anything in the right form; ranks in the order of the list."""

    def __init__(self, answers: Iterable[str] = ()):
        self.answers = list(answers)
        self.who = {"provider": "gemini", "model": "m", "sampling": {}}
        self.requests: list[Request] = []

    def ask(self, request: Request) -> Reply:
        self.requests.append(request)
        answer = self.answers.pop(0) if self.answers else by_schema(dict(request.schema))
        return Reply("answered", answer, "", "m", 1, 1)


def album(settings: Settings) -> Album:
    names = [f"{r}_{view}" for r in settings.renderings for view in settings.views]
    shown = (*stages_of(settings.definition), "seen")
    pictures = {s: {n: Png(f"{s} {n}".encode()) for n in names} for s in shown}
    return Album(pictures, pictures.pop("seen"), settings.image_size)


def everything_said(settings: Settings, folder: Path) -> list[Request]:
    """All requests of a questioning, rankings, and rewards; then with less told.

    The last two are about a bench of one's own, and of a program revised.
    """
    provider = Obliging()
    record = Record(folder, provider)
    shown = album(settings)
    patch = pytest.MonkeyPatch()
    # Flown once, not for each that is told of them.
    flown = moments.ranges(settings)
    patch.setattr(description, "ranges", lambda _: flown)

    def begin() -> Conversation:
        return Conversation(record, "any", 1)

    (sets,) = LISTS.lists
    conversation = begin()
    question(conversation, settings, shown, QUESTIONS)
    order(conversation, sets)
    seen = replace(settings, cams=("dep_front", "seg_side"))
    for pictures in (None, shown):
        begin().ask(reward_prompt(seen, RULES, pictures), ProgramAnswer)
    for detail in ("full", "names", "nothing"):
        scene = description.scene(settings, detail)
        order(begin(), sets, opening(settings, shown, sets, detail, scene))
    for pictures in (None, shown):
        begin().ask(reward_prompt(seen, RULES, pictures, "names"), ProgramAnswer)
    conversation = begin()
    conversation.ask(guess_prompt(seen, shown), Guess)
    conversation.ask(reward_prompt(seen, RULES, shown, "nothing"), ProgramAnswer)
    bench = {name: Png(name.encode()) for name in ("left", "right")}
    order_pictures(begin(), bench, "", [*bench])
    trained = Trained("reward = 1", "step, return", 1000, (Png(b"still"),))
    begin().ask(trained.prompt(reward_prompt(seen, RULES, shown)), ProgramAnswer)
    patch.undo()
    return provider.requests


def text_of(requests: list[Request]) -> str:
    return "\n".join(
        part
        for request in requests
        for message in request.messages
        for part in message.parts
        if isinstance(part, str)
    )
