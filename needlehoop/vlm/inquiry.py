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
from needlehoop.vlm import description, prompts, tables
from needlehoop.vlm.album import Album, open_album
from needlehoop.vlm.config import AskingConfig, InquiryConfig, ReplayConfig, transcripts
from needlehoop.vlm.conversation import Conversation, NoAnswerError, models, totals_of
from needlehoop.vlm.grouping import rank_groups
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.providers import build_provider
from needlehoop.vlm.questions import (
    Lists,
    Questions,
    Ranked,
    opening,
    order,
    order_pictures,
    question,
    rank,
    seen_by,
)
from needlehoop.vlm.recorder import Recorder
from needlehoop.vlm.revision import Trained
from needlehoop.vlm.transcript import Transcript
from needlehoop.vlm.writing import (
    ProgramAttempts,
    ProgramRules,
    Verdict,
    guess_prompt,
    reward_prompt,
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
    """Asks a model for one thing and writes down its answers.

    All that asks raises ``NoAnswerError`` if no answer can be used within the attempts, and
    ``RefusalError`` if the model would not answer.

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
        self._settings, self._config, self._told = settings, config, vlm.told
        self._files = Run(config.folder)
        self._held: list[Conversation] = []
        self._live = not isinstance(vlm, ReplayConfig)
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
        """Ask the questions on cameras, into ``questions.json`` and ``.csv``."""
        if self._told != FULL:
            raise ValueError(
                f"vlm.told: {self._told!r} is for rankings and rewards; these questions are about"
                f" the task, so they are asked with {FULL}"
            )
        questions.check(self._settings)
        album = self._album()
        self._clear("question", "rank", files=(QUESTIONS, RANKINGS))
        return self._question(self._begin("question"), album, questions)

    def _question(
        self, conversation: Conversation, album: Album, questions: Questions
    ) -> dict[str, Any]:
        answers = question(conversation, self._settings, album, questions)
        asked = prompts.questioned(self._settings.definition)
        found = self._write(QUESTIONS, {"answers": answers, "asked": asked})
        self._files.write("questions.csv", tables.questions_csv(answers, asked))
        return found

    def rank(self, questions: Questions, lists: Lists) -> dict[str, Any]:
        """Ask for rankings, into ``rankings.json`` and ``.csv``, and ``agreement.csv``.

        Each sample begins with the questions on cameras, which the totals count too. Lists that
        are ranked afresh, or with less told, go into ``rankings_afresh.json`` (``_names``,
        ``_nothing``) and so on.
        """
        questions.check(self._settings)
        lists.check(self._settings, questions.shown)
        how, told, words = self.ranked(lists), self._told, lists.words or not lists.sets
        scene = description.scene(self._settings, told) if how else ""
        album = self._album([*chain(*lists.sets)])
        self._clear(f"rank{how}", files=(f"rankings{how}.json",))
        questioned: dict[int, Conversation] = {}
        openings: dict[tuple[str, ...], list[Part]] = {}

        def afresh(number: int, sample: int, sets: Sequence[str]) -> Ranked:
            own = seen_by(self._settings, sets)[1] if lists.sets else self._settings
            if (shown := tuple(sets)) not in openings:
                openings[shown] = opening(own, album, sets, told, scene, words)
            name = f"rank{how}/{number}{f'/{sample}' if sample > 1 else ''}"
            return order(self._begin(name), sets, openings[shown])

        def after_questions(number: int, sample: int, sets: Sequence[str]) -> Ranked:
            if sample not in questioned:
                name = "question" if sample == 1 else f"rank/{sample}"
                questioned[sample] = self._begin(name)
                if sample == 1:
                    self._question(questioned[sample], album, questions)
                    questioned[sample].name = "rank"
                else:
                    question(questioned[sample], self._settings, album, questions)
            return order(questioned[sample], sets)

        return self._ranked(how, rank(afresh if how else after_questions, lists))

    def rank_pictures(
        self, pictures: Mapping[str, Png], about: str, lists: Lists
    ) -> dict[str, Any]:
        """Rank cameras by a picture of each, into ``rankings_pictures.json`` and ``.csv``.

        Args:
            pictures: by the camera's name.
            about: what the task is; may be empty.
            lists: ``group`` and ``rounds``.
        """
        self._clear("rank_pictures", files=("rankings_pictures.json",))

        def ask(number: int, names: Sequence[str]) -> Ranked:
            return order_pictures(self._begin(f"rank_pictures/{number}"), pictures, about, names)

        found = rank_groups(ask, tuple(pictures), lists.group, lists.rounds)
        return self._ranked("_pictures", [found])

    def _ranked(self, how: str, ranked: list[dict[str, Any]]) -> dict[str, Any]:
        found = self._write(f"rankings{how}.json", {"lists": ranked})
        self._files.write(f"rankings{how}.csv", tables.rankings_csv(ranked))
        self._files.write(f"agreement{how}.csv", tables.agreement_csv(ranked))
        return found

    def ranked(self, lists: Lists) -> str:
        """What names of files and conversations say of how lists are ranked."""
        told = "" if self._told == FULL else f"_{self._told}"
        if lists.sets:
            return f"_sets{'' if lists.words else '_wordless'}{told}"
        return told or ("_afresh" if lists.afresh else "")

    def reward(
        self,
        flavour: str,
        rules: ProgramRules,
        samples: int = FIRST,
        trained: Trained | None = None,
    ) -> Rewards:
        """Ask for reward programs for the settings' cameras.

        A ``text`` prompt does not depend on the cameras. All camera sets of a study get the same
        recorded answers to it, as in the paper. Attempts that failed are in files too.

        Args:
            flavour: ``text`` or ``image``.
            rules: the judge of programs.
            samples: how many programs, each from a conversation of its own.
            trained: a run whose program is to be made better. The answer becomes the next free
                sample, and ``<sample>.descent.json`` names the runs and programs that it descends
                from, the latest last.

        Raises:
            ValueError: no cameras, an unknown flavour, too little told, or the programs exist
                already.
        """
        cameras = "+".join(self._settings.cams)
        if not cameras:
            raise ValueError("cams: name the cameras, such as cams=[dep_front,seg_side]")
        check_flavour(flavour)
        if trained is not None and self._told != FULL:
            raise ValueError(f"vlm.told: a program is revised with {FULL}")
        nothing = self._told == "nothing"
        if nothing and flavour == "text":
            raise ValueError("vlm.told: nothing goes with flavour=image, which shows pictures")
        if trained is None and self.has_rewards(flavour, samples) and not self._config.overwrite:
            path = self._reward_file(flavour, FIRST)
            raise ValueError(f"{path} exists; overwrite=true asks for another one")
        album = self._album() if flavour == "image" else None
        prompt = reward_prompt(self._settings, rules, flavour, album, self._told)
        first = guess_prompt(self._settings, album) if nothing and album else []
        if trained is None:
            name = "reward/text" if flavour == "text" else f"reward/{cameras}/image"
            name += "" if self._told == FULL else f"/{self._told}"
            self._clear(name)
            names = {n: f"{name}/{n}" if n > FIRST else name for n in self._samples(samples)}
        else:
            prompt = trained.prompt(prompt)
            name = f"reward/{cameras}/{flavour}/revised/{trained.sha256[:12]}"
            names = {
                next(n for n in count(FIRST) if not self._reward_file(flavour, n).exists()): name
            }
        accepted, failed = {}, []
        for sample, name in names.items():
            tried = ProgramAttempts(self._begin(name), rules)
            path = self._reward_file(flavour, sample)
            try:
                source, verdict = self._write_reward(tried, path, prompt, first)
                accepted[sample] = tables.Accepted(verdict.card, rules.values(source))
                if trained is not None:
                    self._write_descent(path, trained)
            except NoAnswerError as error:
                failed.append(error)
        table = None
        if len(accepted) > 1:
            table = tables.compared(f"{flavour}.samples", accepted)
            self._files.write(f"rewards/{cameras}/{table.name}.csv", table.csv())
        if failed:
            raise NoAnswerError("; ".join(map(str, failed)))
        paths = tuple(self._reward_file(flavour, sample) for sample in accepted)
        return Rewards(paths, totals_of(self._held), table)

    def has_rewards(self, flavour: str, samples: int) -> bool:
        """Whether all samples of a reward for the settings' cameras exist."""
        return all(self._reward_file(flavour, n).exists() for n in self._samples(samples))

    def _samples(self, samples: int) -> range:
        return range(FIRST, FIRST + samples)

    def _reward_file(self, flavour: str, sample: int) -> Path:
        cameras = "+".join(self._settings.cams)
        return self._files.folder / "rewards" / cameras / file_name(flavour, sample)

    def _write_reward(
        self, tried: ProgramAttempts, path: Path, prompt: list[Part], first: Sequence[Part]
    ) -> tuple[str, Verdict]:
        """Write one program and the attempts at it into files."""
        place = path.parent.relative_to(self._files.folder)
        try:
            source, verdict = tried.write(prompt, first)
        finally:
            # Failed attempts are kept too.
            rows = "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in tried.rows())
            if rows:
                self._files.write(f"{place / path.stem}.attempts.jsonl", rows)
        self._files.write(str(place / path.name), source)
        return source, verdict

    def _write_descent(self, path: Path, trained: Trained) -> None:
        note = Path(trained.origin).with_suffix(DESCENT)
        before = read_json(note)["line"] if note.is_file() else []
        line = json.dumps({"line": [*before, trained.note()]}, indent=2)
        place = path.with_suffix(DESCENT).relative_to(self._files.folder)
        self._files.write(str(place), line + "\n")

    def _begin(self, name: str) -> Conversation:
        self._held.append(Conversation(self._recorder, name, self._config.attempts))
        return self._held[-1]

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

    def _write(self, name: str, found: dict[str, Any]) -> dict[str, Any]:
        """Write results with their models and their cost. A replay writes the same file."""
        whole = {**found, "models": models(self._held), "totals": totals_of(self._held)}
        self._files.write(name, json.dumps(whole, indent=2, ensure_ascii=False) + "\n")
        return whole
