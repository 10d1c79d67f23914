"""The questions of one study to a model: asks them and writes down the answers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

from needlehoop.envs.settings import Settings
from needlehoop.rewards.written import FIRST, check_flavour, file_name
from needlehoop.runs.reading import read_json
from needlehoop.runs.run import Run
from needlehoop.study.render.table import Table
from needlehoop.vlm import prompts, tables
from needlehoop.vlm.album import Album, open_album
from needlehoop.vlm.config import InquiryConfig
from needlehoop.vlm.conversation import Attempt, Conversation, NoAnswerError, models, totals_of
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.providers import build_provider
from needlehoop.vlm.providers.contract import AskingConfig, ReplayConfig, transcripts
from needlehoop.vlm.questions import (
    Lists,
    Questions,
    question,
    rank,
    rank_afresh,
    rank_pictures,
    rank_sets,
    seen_by,
)
from needlehoop.vlm.recorder import Recorder
from needlehoop.vlm.revision import Trained
from needlehoop.vlm.transcript import Transcript
from needlehoop.vlm.writing import (
    ProgramAttempts,
    ProgramRules,
    guess_prompt,
    reward_prompt,
    write_program,
)

QUESTIONS, RANKINGS, TOTALS = "questions.json", "rankings.json", "totals.csv"

DESCENT = ".descent.json"
"""Ending of the file that says which run and program a revised one descends from."""

FULL = "full"
"""Told all of the task, as the questions on cameras are."""


class Rewards(NamedTuple):
    """Accepted programs: their files, what they cost, and how they differ.

    ``comparison`` is ``None`` for a single program.
    """

    paths: tuple[Path, ...]
    totals: dict[str, int]
    comparison: Table | None


class Inquiry(AbstractContextManager):
    """Asks a model and writes down its answers.

    Args:
        settings: the scene.
        config: where answers are kept, and how often a question is repeated.
        vlm: who answers.

    Raises:
        ValueError: a task that is told to no model, no key, no recording, or a recording of
            another model.
        RuntimeError: the provider's package is not installed.
    """

    def __init__(self, settings: Settings, config: InquiryConfig, vlm: AskingConfig | ReplayConfig):
        asked = prompts.sha256(settings.definition)
        self._settings, self._config = settings, config
        self._files = Run(config.folder)
        self._live, self._told = not isinstance(vlm, ReplayConfig), vlm.told
        if not isinstance(vlm, ReplayConfig):
            provider = build_provider(vlm, config.folder)
            self.transcript = Transcript(config.folder)
            self._recorder = Recorder(self.transcript, provider, vlm, asked=asked)
        else:
            self.transcript = Transcript(vlm.folder(config.folder))
            if not self.transcript.exchanges:
                raise ValueError(
                    f"vlm.recording: nothing is recorded in {self.transcript.path}; ask a model"
                    " with vlm=gemini, openai or manual, or name another recording: a folder, or"
                    f" {', '.join(transcripts())}"
                )
            self._recorder = Recorder(self.transcript, asked=asked)

    def __exit__(self, *_: object) -> None:
        self._recorder.close()
        if self._files.folder.exists():
            # Also after a failure, because that cost something too.
            self._files.replace(TOTALS, tables.totals_csv(self.totals()))

    @property
    def folder(self) -> Path:
        """Where results are written."""
        return self._files.folder

    def totals(self) -> dict[str, dict[str, int]]:
        """What the transcript cost so far, as in ``totals_of_transcript``."""
        return tables.totals_of_transcript(self.transcript.exchanges)

    def question(self, questions: Questions) -> dict[str, Any]:
        """Ask the questions on cameras, into ``questions.json`` and ``.csv``.

        Errors as in ``questions.question``.
        """
        if self._told != FULL:
            raise ValueError(
                f"vlm.told: {self._told!r} is for rankings and rewards; these questions are about"
                f" the task, so they are asked with {FULL}"
            )
        questions.check(self._settings)
        album = self._album()
        self._clear("question", "rank", files=(QUESTIONS, RANKINGS))
        conversation = self._begin("question")
        answers = question(conversation, self._settings, album, questions)
        return self._answered(answers, conversation)

    def rank(self, questions: Questions, lists: Lists) -> dict[str, Any]:
        """Ask for rankings, into ``rankings.json`` and ``.csv``, and ``agreement.csv``.

        Each sample begins with the questions on cameras, which the totals count too. Lists that
        are ranked afresh, or with less told, go into ``rankings_afresh.json`` (``_names``,
        ``_nothing``) and so on. Errors as in ``questions.rank``.
        """
        questions.check(self._settings)
        lists.check(self._settings, questions.shown)
        how, held = self.ranked(lists), []
        album = self._album([*chain(*lists.sets)])
        self._clear(f"rank{how}", files=(f"rankings{how}.json",))

        def fresh(number: int, sample: int) -> Conversation:
            held.append(self._begin(f"rank{how}/{number}{f'/{sample}' if sample > 1 else ''}"))
            return held[-1]

        def questioned(sample: int) -> Conversation:
            conversation = self._begin("question" if sample == 1 else f"rank/{sample}")
            held.append(conversation)
            answers = question(conversation, self._settings, album, questions)
            if sample == 1:
                self._answered(answers, conversation)
                conversation.name = "rank"
            return conversation

        if lists.sets:
            ranked = rank_sets(fresh, self._settings, album, lists, self._told)
        elif how:
            ranked = rank_afresh(fresh, self._settings, album, lists, self._told)
        else:
            ranked = rank(questioned, lists)
        return self._ranked(how, ranked, held)

    def rank_pictures(
        self, pictures: Mapping[str, Png], about: str, lists: Lists
    ) -> dict[str, Any]:
        """Rank cameras by a picture of each, into ``rankings_pictures.json`` and ``.csv``.

        Errors as in ``questions.rank``.
        """
        held: list[Conversation] = []
        self._clear("rank_pictures", files=("rankings_pictures.json",))

        def fresh(number: int) -> Conversation:
            held.append(self._begin(f"rank_pictures/{number}"))
            return held[-1]

        return self._ranked("_pictures", [rank_pictures(fresh, pictures, about, lists)], held)

    def _ranked(
        self, how: str, ranked: list[dict[str, Any]], held: Sequence[Conversation]
    ) -> dict[str, Any]:
        attempts = [attempt for conversation in held for attempt in conversation.attempts]
        found = self._write(f"rankings{how}.json", {"lists": ranked}, attempts)
        self._files.write(f"rankings{how}.csv", tables.rankings_csv(ranked))
        self._files.write(f"agreement{how}.csv", tables.agreement_csv(ranked))
        return found

    def ranked(self, lists: Lists) -> str:
        """What names of files and conversations say of how lists are ranked."""
        told = "" if self._told == FULL else f"_{self._told}"
        if lists.sets:
            return f"_sets{'' if lists.words else '_wordless'}{told}"
        return told or ("_afresh" if lists.afresh else "")

    def reward(self, flavour: str, rules: ProgramRules, samples: int = FIRST) -> Rewards:
        """Ask for reward programs for the settings' cameras.

        A ``text`` prompt does not depend on the cameras. All camera sets of a study get the same
        recorded answers to it, as in the paper.

        Args:
            flavour: ``text`` or ``image``.
            rules: the language and its judge.
            samples: how many programs, each from a conversation of its own.

        Raises:
            ValueError: no cameras, an unknown flavour, or the programs exist already.
            NoAnswerError: some sample has no accepted program. It is raised after all samples
                were asked for, and all attempts are in files.
            RefusalError: the model would not answer.
        """
        cameras = "+".join(self._settings.cams)
        if not cameras:
            raise ValueError("cams: name the cameras, such as cams=[dep_front,seg_side]")
        check_flavour(flavour)
        if samples < FIRST:
            raise ValueError(f"samples: {samples} must be at least {FIRST}")
        if self.has_rewards(flavour, samples) and not self._config.overwrite:
            path = self._reward_file(flavour, FIRST)
            raise ValueError(f"{path} exists; overwrite=true asks for another one")
        nothing = self._told == "nothing"
        if nothing and flavour == "text":
            raise ValueError("vlm.told: nothing goes with flavour=image, which shows pictures")
        name = "reward/text" if flavour == "text" else f"reward/{cameras}/image"
        name += "" if self._told == FULL else f"/{self._told}"
        album = self._album() if flavour == "image" else None
        self._clear(name)
        prompt = reward_prompt(self._settings, rules, flavour, album, self._told)
        first = guess_prompt(self._settings, album) if nothing and album else []
        accepted, attempts, failed = {}, [], []
        for sample in range(FIRST, FIRST + samples):
            tried = ProgramAttempts(self._begin(name if sample == FIRST else f"{name}/{sample}"))
            try:
                source = self._write_reward(tried, [first, prompt], rules, flavour, sample)
                accepted[sample] = tables.AcceptedProgram(tried.card, rules.values(source))
            except NoAnswerError as error:
                failed.append(error)
            attempts += tried.conversation.attempts
        table = None
        if len(accepted) > 1:
            table = tables.compared(f"{flavour}.samples", accepted)
            place = f"rewards/{cameras}/{table.name}.csv"
            self._files.write(place, table.csv())
        if failed:
            raise NoAnswerError("; ".join(map(str, failed)))
        paths = tuple(self._reward_file(flavour, sample) for sample in accepted)
        return Rewards(paths, totals_of(attempts), table)

    def revise(self, flavour: str, rules: ProgramRules, trained: Trained) -> Rewards:
        """Ask for a better program than the one that a run was trained on.

        It becomes the next free sample. ``<sample>.descent.json`` names the runs and programs that
        it descends from, the latest last.

        Args:
            flavour: ``text`` or ``image``; of the new program.
            rules: the language and its judge.
            trained: the run.

        Raises:
            ValueError: no cameras, or an unknown flavour.
            NoAnswerError: no program was accepted; all attempts are in files.
            RefusalError: the model would not answer.
        """
        cameras = "+".join(self._settings.cams)
        if not cameras:
            raise ValueError("cams: name the cameras, such as cams=[dep_front,seg_side]")
        check_flavour(flavour)
        if self._told != FULL:
            raise ValueError(f"vlm.told: a program is revised with {FULL}")
        album = self._album() if flavour == "image" else None
        prompt = trained.prompt(reward_prompt(self._settings, rules, flavour, album))
        name = f"reward/{cameras}/{flavour}/revised/{trained.sha256[:12]}"
        tried = ProgramAttempts(self._begin(name))
        sample = next(n for n in count(FIRST) if not self._reward_file(flavour, n).exists())
        self._write_reward(tried, [[], prompt], rules, flavour, sample)
        path = self._reward_file(flavour, sample)
        note = Path(trained.origin).with_suffix(DESCENT)
        before = read_json(note)["line"] if note.is_file() else []
        place = path.with_suffix(DESCENT).relative_to(self._files.folder)
        line = json.dumps({"line": [*before, trained.note()]}, indent=2)
        self._files.write(str(place), line + "\n")
        return Rewards((path,), totals_of(tried.conversation.attempts), None)

    def has_rewards(self, flavour: str, samples: int) -> bool:
        """Whether all samples of a reward for the settings' cameras exist."""
        wanted = range(FIRST, FIRST + samples)
        return all(self._reward_file(flavour, sample).exists() for sample in wanted)

    def _reward_file(self, flavour: str, sample: int) -> Path:
        cameras = "+".join(self._settings.cams)
        return self._files.folder / "rewards" / cameras / file_name(flavour, sample)

    def _write_reward(
        self,
        tried: ProgramAttempts,
        asked: Sequence[list[Part]],
        rules: ProgramRules,
        flavour: str,
        sample: int,
    ) -> str:
        """Write one program and the attempts at it into files. Errors as in ``reward``."""
        path = self._reward_file(flavour, sample)
        place = path.parent.relative_to(self._files.folder)
        try:
            first, prompt = asked
            program = write_program(tried, prompt, rules, first)
        finally:
            # Failed attempts are kept too.
            rows = "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in tried.rows())
            if rows:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._files.write(f"{place / path.stem}.attempts.jsonl", rows)
        self._files.write(str(place / path.name), program)
        return program

    def _begin(self, name: str) -> Conversation:
        return Conversation(self._recorder, name, self._config.attempts)

    def _album(self, sets: Sequence[str] = ()) -> Album:
        """Of the scene's cameras, or of those of ``sets`` alone."""
        settings = seen_by(self._settings, sets)[1] if sets else self._settings
        return open_album(self.transcript, settings, self._config.size)

    def _clear(self, *conversations: str, files: Sequence[str] = ()) -> None:
        """With ``overwrite``, retire old answers. A replay keeps them: it can give no others."""
        if not (self._config.overwrite and self._live):
            return
        self.transcript.retire(
            lambda name: any(name == c or name.startswith(f"{c}/") for c in conversations)
        )
        for name in files:
            self._files.vacate(name)

    def _answered(self, answers: dict[str, Any], conversation: Conversation) -> dict[str, Any]:
        asked = prompts.questioned(self._settings.definition)
        named = {"asked": asked}
        found = self._write(QUESTIONS, {"answers": answers, **named}, conversation.attempts)
        self._files.write("questions.csv", tables.questions_csv(answers, asked))
        return found

    def _write(
        self, name: str, found: dict[str, Any], attempts: Sequence[Attempt]
    ) -> dict[str, Any]:
        """Write results with their models and their cost. A replay writes the same file."""
        whole = {**found, "models": models(attempts), "totals": totals_of(attempts)}
        self._files.folder.mkdir(parents=True, exist_ok=True)
        self._files.write(name, json.dumps(whole, indent=2, ensure_ascii=False) + "\n")
        return whole
