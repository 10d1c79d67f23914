"""Reward programs: asked for, judged, sent back until one is accepted; revised after a training."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from PIL import Image

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.program import ProgramError, compile_program
from needlehoop.rewards.program_reward import KINDS
from needlehoop.runs.files import METRICS, VIDEO
from needlehoop.runs.run import Run
from needlehoop.scene.image_size import extent
from needlehoop.vlm import description
from needlehoop.vlm.album import Album
from needlehoop.vlm.config import Gates
from needlehoop.vlm.conversation import Conversation, Guess, ProgramAnswer, Verdict
from needlehoop.vlm.description import fill, telling_of
from needlehoop.vlm.gate_report import gate_report
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.moments import collect


@dataclass(frozen=True)
class ProgramRules:
    """The range that a program's value must keep to, and the judge of what a model writes."""

    lowest: float
    highest: float
    judge: Callable[[str], Verdict]


def program_rules(settings: Settings, gates: Gates) -> ProgramRules:
    """The rules with the gates as their judge; errors are as in ``collect``."""
    task = settings.definition
    # What the scripts cannot drive is refused before a model is asked.
    collect(settings, gates)

    def judge(source: str) -> Verdict:
        try:
            program = compile_program(source, task.signals)
        except ProgramError as error:
            return Verdict(str(error))
        report = gate_report(program, settings, gates)
        # Naming the cheat, or where the teacher stopped, would tell the model what success is.
        hidden = {task.cheating: "an episode that fails at the task"}
        hidden |= {f"the teacher {how}": "an episode that stops short" for how in report.stopped}
        reason = "; ".join(report.reasons)
        for name, phrase in hidden.items():
            reason = reason.replace(name, phrase)
        return Verdict(reason or None, report.as_dict())

    return ProgramRules(gates.low, gates.high, judge)


def write_program(
    conversation: Conversation, rules: ProgramRules, prompt: list[Part], first: Sequence[Part] = ()
) -> str:
    """Ask for a program until one is accepted; its source. Errors are as in ``Conversation.ask``.

    ``first``: a question that comes before: what the task is taken to be.
    """

    def judge(answer: ProgramAnswer) -> Verdict:
        reason, report = rules.judge(_bare(answer.program))
        return Verdict(reason and f"the program was refused: {reason}", report)

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
                # The name of a gate report in the files of earlier studies.
                "card": dict(verdict.report) if is_program else None,
            }
        )
    return rows


def reward_prompt(
    settings: Settings,
    rules: ProgramRules,
    album: Album | None = None,
    prompt_detail: str = "full",
) -> list[Part]:
    """The text that asks for a program and, with an album, the cameras' start pictures.

    ``prompt_detail``: without ``full``, signals come with their ranges alone; ``nothing`` follows
    ``guess_prompt``, which has the pictures.
    """
    task = settings.definition
    gaps = {"lowest": f"{rules.lowest:g}", "highest": f"{rules.highest:g}"}
    gaps["language"] = description.language()
    if prompt_detail == "full":
        scene, signals = description.scene(settings), description.signals(settings)
        text = fill("reward", task, scene=scene, signals=signals, **gaps)
    else:
        scene = description.scene(settings, "nothing") if prompt_detail == "names" else ""
        signals = description.unexplained(settings)
        text = fill("reward", scene=scene, signals=signals, done="the task is done", **gaps)
    if album is None or prompt_detail == "nothing":
        return [text]
    telling, views, cameras = telling_of(task), settings.views, {}
    for camera in settings.cameras:
        kind = settings.renderings[camera.rendering]
        shown = description.rendering(kind, telling, views)
        cameras[camera.name] = (
            f"{description.view(views[camera.view], task, settings.image_size)}; {shown}"
        )
    pixels, listed = extent(settings.image_size), description.bullets(cameras)
    text = fill("reward_images", reward=text, cameras=listed, pixels=pixels)
    return [text, *album.show([*cameras], "start")]


def guess_prompt(settings: Settings, album: Album) -> list[Part]:
    """What asks a model, told nothing of the task, what it takes the task to be."""
    scene = description.scene(settings, "names")
    text = fill("guess", told=scene, stages=description.stages(settings, "nothing"))
    shown = album.renamed(description.stage_names(settings, "nothing"))
    return [text, *shown.show(settings.cams)]


def _bare(program: str) -> str:
    """The program without the fence that models put around code; one newline at its end."""
    fenced = re.fullmatch(r"\s*```[a-zA-Z]*\n(.*?)\n?```\s*", program, re.DOTALL)
    return (fenced.group(1) if fenced else program).strip() + "\n"


_ROWS, _STILLS = 10, 6


@dataclass(frozen=True)
class Trained:
    """A program, and what came of a training on it."""

    program: str
    curves: str
    """A table: step, return, terms, and the share of episodes in which the task was done."""
    steps: int
    stills: tuple[Png, ...]
    """Of the run's film, from its beginning to its end; none: there is no film."""

    def prompt(self, reward: Sequence[Part]) -> list[Part]:
        """The question for a better program, after the one that asked for the first."""
        text, *pictures = reward
        film = "There is no film of the trained agent."
        if self.stills:
            film = "Below the other pictures: stills of a film of the trained agent, in order."
        gaps = {"program": self.program.strip(), "curves": self.curves, "steps": f"{self.steps:,}"}
        shown = [fill("revise", reward=text, stills=film, **gaps), *pictures]
        for number, still in enumerate(self.stills, 1):
            shown += [f"trained agent, still {number} of {len(self.stills)}:", still]
        return shown


def read_run(folder: Path, size: int) -> Trained:
    """What a run's files say of its training; ``size``: a still's longer side, pixels, at most.

    ``ValueError``: no run, or one whose reward was no program.
    """
    run = Run.open(folder, "revise")
    reward = run.config()["reward"]
    if reward["kind"] not in KINDS:
        raise ValueError(f"revise: {folder} was trained on no program, so there is none to revise")
    rows = run.rows(METRICS)
    film, steps = folder / VIDEO, int(rows[-1]["step"])
    stills = _stills(film, size) if film.is_file() else ()
    return Trained(reward["program"]["text"], _curves(rows), steps, stills)


def _curves(rows: Sequence[dict[str, str]]) -> str:
    """Some rows of the metrics, evenly over the training; terms by their names in the program.

    A dash stands where no episode ended.
    """
    # Facts would tell what success is.
    terms = [name for name in rows[0] if name.startswith("term_")]
    columns = ["return", *terms, "success"]
    lines = [", ".join(("step", "return", *(name[5:] for name in terms), "done"))]
    for row in (rows[number] for number in _evenly(len(rows), _ROWS)):
        values = (f"{float(row[c]):.3g}".replace("nan", "-") if row[c] else "-" for c in columns)
        lines.append(", ".join((row["step"], *values)))
    return "\n".join(lines)


def _evenly(count: int, chosen: int) -> list[int]:
    """Different places in a list of ``count`` entries, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, chosen).round().astype(int)).tolist()


def _stills(film: Path, size: int) -> tuple[Png, ...]:
    reader: Any = imageio.get_reader(film)
    with reader:
        frames = [np.asarray(frame) for frame in reader]
    chosen = _evenly(len(frames), _STILLS)
    return tuple(Png.of(Image.fromarray(frames[number]), size) for number in chosen)
