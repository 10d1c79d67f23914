"""Reward programs: asked for, judged, sent back until one is accepted; revised after a training."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pandas as pd
from PIL import Image

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.program import compile_program
from needlehoop.rewards.written import KINDS
from needlehoop.runs.files import METRICS, VIDEO
from needlehoop.runs.reading import named, read_json
from needlehoop.runs.run import Run
from needlehoop.study.data.records import read_rows
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.card import card
from needlehoop.vlm.config import Gates
from needlehoop.vlm.conversation import Conversation, Guess, ProgramAnswer, Verdict
from needlehoop.vlm.description import fill, telling_of
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.moments import collect


@dataclass(frozen=True)
class ProgramRules:
    """What a program must keep to, and the judge of what a model writes."""

    lowest: float
    highest: float
    """The range that a program's value must keep to."""
    judge: Callable[[str], Verdict]


def program_rules(settings: Settings, gates: Gates) -> ProgramRules:
    """The rules with the gates as their judge, whose trajectories are recorded here, once."""
    trajectories, table = collect(settings, gates), settings.definition.signals

    def judge(source: str) -> Verdict:
        try:
            program = compile_program(source, table)
        except ProgramError as error:
            return Verdict(str(error))
        found = card(program, settings, gates, trajectories)
        # Naming the cheat, or where the teacher stopped, would tell the model what success is.
        named = {settings.definition.cheating: "an episode that fails at the task"}
        named |= {f"the teacher {how}": "an episode that stops short" for how in found.stopped}
        reason = "; ".join(found.reasons)
        for name, said in named.items():
            reason = reason.replace(name, said)
        return Verdict(reason or None, found.as_dict())

    return ProgramRules(gates.low, gates.high, judge)


def write_program(
    conversation: Conversation, rules: ProgramRules, prompt: list[Part], first: Sequence[Part] = ()
) -> str:
    """Ask for a program until one is accepted; its source. Errors are as in ``Conversation.ask``.

    ``first``: a question that comes before: what the task is taken to be.
    """

    def judge(answer: ProgramAnswer) -> Verdict:
        reason, card = rules.judge(_bare(answer.program))
        return Verdict(reason and f"the program was refused: {reason}", card)

    if first:
        conversation.ask(first, Guess)
    return _bare(conversation.ask(prompt, ProgramAnswer, judge).program)


def rows_of(conversation: Conversation) -> list[dict[str, Any]]:
    """All answers of a conversation about a program as plain values, whatever their form."""
    rows = []
    for number, (exchange, answer, verdict) in enumerate(conversation.attempts, 1):
        is_program = isinstance(answer, ProgramAnswer)
        rows.append(
            {
                "attempt": number,
                "request": exchange.sha256,
                "answer": exchange.answer,
                "program": _bare(answer.program) if is_program else None,
                "accepted": is_program and verdict.reason is None,
                "reason": verdict.reason,
                "card": dict(verdict.card) if is_program else None,
            }
        )
    return rows


def reward_prompt(
    settings: Settings, rules: ProgramRules, album: Album | None = None, told: str = "full"
) -> list[Part]:
    """The text that asks for a program and, with an album, the cameras' start pictures.

    ``told``: ``full``; ``names``: signals with their ranges, and no word of the task; ``nothing``:
    the same after ``guess_prompt``, which has the pictures.
    """
    asked = {"lowest": f"{rules.lowest:g}", "highest": f"{rules.highest:g}"}
    asked["language"] = description.language()
    if told == "full":
        said, signals = description.scene(settings), description.signals(settings)
        text = fill("reward", settings.definition, scene=said, signals=signals, **asked)
    else:
        said = description.scene(settings, "nothing") if told == "names" else ""
        signals = description.unexplained(settings)
        text = fill("reward", scene=said, signals=signals, done="the task is done", **asked)
    if album is None or told == "nothing":
        return [text]
    telling = telling_of(settings.definition)
    cameras = {
        camera.name: f"{description.view(settings.views[camera.view], settings.definition)};"
        f" {description.rendering(settings.renderings[camera.rendering], telling, settings.views)}"
        for camera in settings.cameras
    }
    pixels, listed = settings.image_size, description.bullets(cameras)
    text = fill("reward_images", reward=text, cameras=listed, pixels=pixels)
    return [text, *album.show(list(cameras), "start")]


def guess_prompt(settings: Settings, album: Album) -> list[Part]:
    """What asks a model, told nothing of the task, what it takes the task to be."""
    told = description.scene(settings, "names")
    said = fill("guess", told=told, stages=description.stages(settings, "nothing"))
    return [said, *album.named(description.stage_names(settings, "nothing")).show(settings.cams)]


def _bare(program: str) -> str:
    """The program without the fence that models put around code; one newline at its end."""
    fenced = re.fullmatch(r"\s*```[a-zA-Z]*\n(.*?)\n?```\s*", program, re.DOTALL)
    return (fenced.group(1) if fenced else program).strip() + "\n"


DESCENT = ".descent.json"
"""Ending of the file that says which run and program a revised one descends from."""

_ROWS, _STILLS = 10, 6


@dataclass(frozen=True)
class Trained:
    """A program, and what came of a training on it."""

    folder: str
    program: str
    origin: str
    """The file that the program came from."""
    curves: str
    """A table: step, return, terms, and the share of episodes in which the task was done."""
    steps: int
    stills: tuple[Png, ...]
    """Of the run's film, from its beginning to its end; none: there is no film."""

    @property
    def sha256(self) -> str:
        """Of the program."""
        return hashlib.sha256(self.program.encode()).hexdigest()

    def descent(self) -> str:
        """A note for a program that descends from this one: runs and programs, the latest last."""
        note = Path(self.origin).with_suffix(DESCENT)
        before = read_json(note)["line"] if note.is_file() else []
        own = {"run": self.folder, "program": self.origin, "sha256": self.sha256}
        return json.dumps({"line": [*before, own]}, indent=2) + "\n"

    def prompt(self, reward: Sequence[Part]) -> list[Part]:
        """The question for a better program, after the one that asked for the first."""
        (text, *pictures) = reward
        film = "There is no film of the trained agent."
        if self.stills:
            film = "Below the other pictures: stills of a film of the trained agent, in order."
        own = {"program": self.program.strip(), "curves": self.curves, "steps": f"{self.steps:,}"}
        shown = [fill("revise", reward=text, stills=film, **own), *pictures]
        for number, still in enumerate(self.stills, 1):
            shown += [f"trained agent, still {number} of {len(self.stills)}:", still]
        return shown


def read_run(folder: Path, size: int) -> Trained:
    """What a run's files say of its training; ``size``: a still's longer side, pixels, at most.

    ``ValueError``: no run, one that was not paid by a program, or damaged files.
    """
    match Run.open(folder).config().get("reward"):
        case {"kind": kind, "program": {"text": str(text), "origin": str(origin)}} if kind in KINDS:
            pass
        case _:
            raise ValueError(
                f"revise: {folder} was trained on no program, so there is none to revise"
            )
    with named(f"revise: {folder / METRICS}"):
        rows = read_rows(folder / METRICS)
    if rows is None:
        raise ValueError(f"revise: {folder} has trained nothing yet")
    steps, film = int(rows["step"].iloc[-1]), folder / VIDEO
    stills = _stills(film, size) if film.is_file() else ()
    return Trained(str(folder), text, origin, _curves(rows), steps, stills)


def _curves(rows: pd.DataFrame) -> str:
    """Some rows of the metrics, evenly over the training; terms by their names in the program.

    A dash stands where no episode ended.
    """
    # Facts would tell what success is.
    columns = ["return", *(c for c in rows if c.startswith("term_")), "success"]
    names = (column.removeprefix("term_") for column in columns[:-1])
    lines = [", ".join(("step", *names, "done"))]
    for row in sorted({round(i * (len(rows["step"]) - 1) / (_ROWS - 1)) for i in range(_ROWS)}):
        values = ("-" if np.isnan(v := rows[c][row]) else f"{v:.3g}" for c in columns)
        lines.append(", ".join((f"{rows['step'][row]:.0f}", *values)))
    return "\n".join(lines)


def _stills(film: Path, size: int) -> tuple[Png, ...]:
    try:
        with imageio.get_reader(film) as opened:
            reader: Any = opened
            frames = [np.asarray(frame) for frame in reader]
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"revise: {film}: no film ({str(error).splitlines()[0]})") from error
    chosen = [round(i * (len(frames) - 1) / (_STILLS - 1)) for i in range(_STILLS)]
    return tuple(Png.of(Image.fromarray(frames[number]), size) for number in chosen)
