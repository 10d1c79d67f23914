"""Questions in folders, for people who have a chat window and no key."""

from __future__ import annotations

import json
import re
import sys
import time
from itertools import count
from pathlib import Path

from needlehoop.runs.files import write_whole
from needlehoop.vlm.config import ManualConfig
from needlehoop.vlm.messages import Part, Reply, Request

ANSWERS = ("answer.json", "answer.md", "answer.txt")
"""Names that an answer's file may have."""

_GUIDE = """\
Give a vision-language model what stands below the line, with each picture at the place that
names it. Save what it answers in this folder: as answer.json, or all that it said as answer.md.
"""


class UnansweredError(RuntimeError):
    """Nobody answered in time. Nothing is recorded."""


class Manual:
    """Writes each request into a folder of the study's record and waits for an answer there."""

    def __init__(self, config: ManualConfig, folder: Path):
        self._config, self._folder = config, folder
        self.who = {"provider": config.kind, "model": config.model, "sampling": {}}

    def ask(self, request: Request) -> Reply:
        """The answer, once its file is there; ``UnansweredError`` when the time to wait is over.

        A request whose folder exists is not written again.
        """
        place = self._folder / "asked" / request.sha256[:16]
        if not (place / "request.md").exists():
            write_request(request, place)
        answer = find_json(self._wait(place))
        # Moved away, because the same question may be asked again.
        done = self._folder / "answered"
        done.mkdir(parents=True, exist_ok=True)
        free = next(n for n in count(1) if not any(done.glob(f"{n:03d}_*")))
        place.rename(done / f"{free:03d}_{place.name}")
        return Reply("answered", answer, "", self._config.model, None, None, ("by hand",))

    def _wait(self, place: Path) -> str:
        """What is in the answer's file, which must not be empty; of several the first name's."""
        config, began, before, is_told = self._config, time.monotonic(), "", False
        while True:
            path = next((place / name for name in ANSWERS if (place / name).is_file()), None)
            answer = path.read_text("utf-8-sig").strip() if path else ""
            # It has not changed since the last look, so nobody is still writing it.
            if answer and answer == before:
                return answer
            if not answer and not is_told:
                print(
                    f"vlm=manual: give {place / 'request.md'} and its pictures to {config.model},"
                    f" and save the answer beside it as {ANSWERS[0]} (as it is: {ANSWERS[1]});"
                    " Ctrl-C stops, and the same command goes on",
                    file=sys.stderr,
                    flush=True,
                )
                is_told = True
            if not answer and config.wait is not None and time.monotonic() - began >= config.wait:
                raise UnansweredError(
                    f"{place}: no answer yet; put it there, and the same command goes on"
                )
            before = answer
            time.sleep(config.poll)


def write_request(request: Request, place: Path) -> None:
    """``schema.json``, pictures ``01.png``, … and, last, ``request.md``, in a folder made here."""
    place.mkdir(parents=True, exist_ok=True)
    # The pictures of all turns are numbered through.
    numbers = count(1)

    def put(part: Part) -> str:
        if isinstance(part, str):
            return f"{part}\n"
        name = f"{next(numbers):02d}.png"
        write_whole(place / name, part.png)
        return f"[picture {name}]\n"

    turns = [[put(part) for part in message.parts] for message in request.messages]
    schema = json.dumps(request.schema, indent=2, ensure_ascii=False)
    write_whole(place / "schema.json", schema + "\n")
    lines = [_GUIDE, "---\n"]
    if len(turns) > 1:
        remember = "What was said before is needed where the model does not remember it.\n"
        lines = [_GUIDE, remember, "---\n", "# What was said before\n"]
        for message, turn in zip(request.messages[:-1], turns, strict=False):
            is_answer = message.role == "assistant"
            lines += ["## The model answered\n" if is_answer else "## It was asked\n", *turn]
        lines += ["# What is asked now\n"]
    form = "Answer with one JSON object of this schema, and nothing else:\n\n"
    lines += [*turns[-1], f"{form}```json\n{schema}\n```\n"]
    write_whole(place / "request.md", "\n".join(lines))


def find_json(said: str) -> str:
    """The JSON object in a model's text: all of it, in a fence, or between braces.

    A text without one is returned as it is, to be refused like any malformed answer.
    """
    fenced = re.findall(r"^```\w*[ \t]*\n(.*?)^```", said, re.DOTALL | re.MULTILINE)
    braces = said[said.find("{") : said.rfind("}") + 1]
    for text in (said, *reversed(fenced), braces):
        try:
            if isinstance(json.loads(text), dict):
                return text.strip()
        except (ValueError, RecursionError):
            continue
    return said
