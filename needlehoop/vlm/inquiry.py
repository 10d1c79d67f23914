"""The questions of one study to a model: asks them and writes down the answers."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import chain, count
from pathlib import Path
from typing import Any

from needlehoop.config.strict import check_names
from needlehoop.envs.settings import Settings
from needlehoop.rewards.program_reward import file_name
from needlehoop.runs.files import csv_text, write_whole
from needlehoop.runs.run import Run
from needlehoop.study.data.answers import QUESTIONS, RANKINGS, as_rows
from needlehoop.vlm import description, questions, writing
from needlehoop.vlm.album import Album, open_album
from needlehoop.vlm.config import InquiryConfig, ReplayConfig, VlmConfig, transcripts
from needlehoop.vlm.conversation import Conversation, NoAnswerError, totals_of
from needlehoop.vlm.messages import Part, Png
from needlehoop.vlm.providers import provider_of
from needlehoop.vlm.questions import Lists, Questions
from needlehoop.vlm.record import Record
from needlehoop.vlm.writing import ProgramRules, Trained


class Inquiry(AbstractContextManager):
    """Asks a model for one thing and writes down its answers.

    Whatever asks raises the errors of ``Conversation.ask``. ``ValueError`` here: a task without
    words for a model, no key, no recording, or a recording of another model.
    """

    def __init__(self, settings: Settings, config: InquiryConfig, vlm: VlmConfig):
        description.texts(settings.definition)
        self._settings, self._config, self._detail = settings, config, vlm.prompt_detail
        self.folder, self._files = config.folder, Run(config.folder)
        self._live = not isinstance(vlm, ReplayConfig)
        if isinstance(vlm, ReplayConfig):
            self.record = Record(vlm.folder(self.folder))
            if not self.record.exchanges:
                raise ValueError(
                    f"vlm.recording: nothing is recorded in {self.record.path}; ask a model"
                    " with vlm=gemini, openai or manual, or name another recording: a folder, or"
                    f" {', '.join(transcripts())}"
                )
        else:
            self.record = Record(self.folder, provider_of(vlm, self.folder))

    def __exit__(self, *_: object) -> None:
        if self.folder.exists():
            # Also after a failure, because that cost something too.
            costs = totals_of(self.record.exchanges)
            rows = [(name, *row.values()) for name, row in costs.items()]
            write_whole(self.folder / "totals.csv", csv_text(("conversation", *costs["all"]), rows))

    def question(self, topics: Questions) -> dict[str, Any]:
        """Ask the questions on cameras, into ``questions.json`` and ``.csv``."""
        if self._detail != "full":
            raise ValueError(
                f"vlm.prompt_detail: {self._detail!r} is for rankings and rewards; these questions"
                " are about the task, so they are asked with full"
            )
        check_names("shown", topics.shown, tuple(self._settings.renderings))
        album = self._album()
        self._clear("question", "rank", files=(QUESTIONS, RANKINGS))
        return self._question(self._begin("question"), album, topics)

    def _question(
        self, conversation: Conversation, album: Album, topics: Questions
    ) -> dict[str, Any]:
        answers = questions.question(conversation, self._settings, album, topics)
        moments = description.questioned(self._settings.definition)
        result = self._write(QUESTIONS, {"answers": answers, "asked": moments})
        rows = [(row.question, row.answer, row.reason) for row in as_rows(answers, moments)]
        self._files.write("questions.csv", csv_text(("question", "answer", "reason"), rows))
        return result

    def rank(self, topics: Questions, lists: Lists) -> dict[str, Any]:
        """Ask for rankings, into ``rankings.json`` and ``.csv``, and ``agreement.csv``.

        Each sample begins with the questions on cameras, which the totals count too. Lists that
        are ranked afresh, or with less told, go into ``rankings_afresh.json`` (``_names``,
        ``_nothing``) and so on, each from a conversation of its own.
        """
        check_names("shown", topics.shown, tuple(self._settings.renderings))
        lists.check(self._settings, topics.shown)
        how, detail, settings = self.suffix(lists), self._detail, self._settings
        scene = description.scene(settings, detail) if how else ""
        album = self._album([*chain(*lists.sets)])
        self._clear(f"rank{how}", files=(f"rankings{how}.json",))
        conversation, answers = self._begin("question"), defaultdict(list)
        for number, part, sets in lists.asked():
            before: Sequence[Part] = ()
            again = f"/{part}" if part > 1 else ""
            if how:
                conversation = self._begin(f"rank{how}/{number}{again}")
                # For sets the views that they have are described, for lists all views.
                env = questions.narrowed(settings, sets) if lists.sets else settings
                before = questions.opening(env, album, sets, detail, scene)
            elif (number, part) == (1, 1):
                self._question(conversation, album, topics)
                conversation.name = "rank"
            elif number == 1:
                conversation = self._begin(f"rank{again}")
                questions.question(conversation, settings, album, topics)
            answers[number].append(questions.order(conversation, sets, before))
        ranked = [
            questions.of_groups(sets, lists.group, lists.rounds, answers[number])
            if lists.sets
            else questions.of_samples(sets, answers[number])
            for number, sets in enumerate(lists.sets or lists.lists, 1)
        ]
        return self._write_rankings(how, ranked)

    def rank_pictures(
        self, pictures: Mapping[str, Png], about: str, lists: Lists
    ) -> dict[str, Any]:
        """Rank cameras by a picture of each, into ``rankings_pictures.json`` and ``.csv``.

        ``about``: what the task is; may be empty. Of ``lists``, ``group`` and ``rounds`` count.
        """
        self._clear("rank_pictures", files=("rankings_pictures.json",))
        names, how = tuple(pictures), (lists.group, lists.rounds)
        answers = []
        for number, dealt in enumerate(questions.deal(names, *how), 1):
            conversation = self._begin(f"rank_pictures/{number}")
            answers.append(questions.order_pictures(conversation, pictures, about, dealt))
        return self._write_rankings("_pictures", [questions.of_groups(names, *how, answers)])

    def _write_rankings(self, how: str, ranked: list[dict[str, Any]]) -> dict[str, Any]:
        result = self._write(f"rankings{how}.json", {"lists": ranked})
        self._files.write(f"rankings{how}.csv", questions.rankings_csv(ranked))
        self._files.write(f"agreement{how}.csv", questions.agreement_csv(ranked))
        return result

    def suffix(self, lists: Lists) -> str:
        """The suffix of files and conversations for this way of ranking: ``_sets``, ``_names``,
        ``_afresh`` or none.
        """
        less = "" if self._detail == "full" else f"_{self._detail}"
        if lists.sets:
            return f"_sets{less}"
        return less or ("_afresh" if lists.afresh else "")

    def reward(
        self,
        flavour: str,
        rules: ProgramRules,
        samples: int = 1,
        trained: Trained | None = None,
    ) -> list[Path]:
        """Ask for reward programs for the settings' cameras; the files of the accepted ones.

        A ``text`` prompt does not depend on the cameras, so all camera sets of a study get the
        same recorded answers to it, as in the paper. Attempts that failed are in files too. Each
        of the ``samples`` has a conversation of its own. ``trained``: a run whose program is to be
        made better. The answer becomes the next free sample.
        """
        detail, settings, cameras = self._detail, self._settings, "+".join(self._settings.cams)
        if not cameras:
            raise ValueError("cams: name the cameras, such as cams=[dep_front,seg_side]")
        if detail == "nothing" and flavour == "text":
            raise ValueError(
                "vlm.prompt_detail: nothing goes with flavour=image, which shows pictures"
            )
        if trained is None and self.has_rewards(flavour, samples) and not self._config.overwrite:
            path = self.folder / self._reward_file(flavour, 1)
            raise ValueError(f"{path} exists; overwrite=true asks for another one")
        album = self._album() if flavour == "image" else None
        prompt = writing.reward_prompt(settings, rules, album, detail)
        first = writing.guess_prompt(settings, album) if detail == "nothing" and album else []
        if trained is None:
            name = "reward/text" if flavour == "text" else f"reward/{cameras}/image"
            name += "" if detail == "full" else f"/{detail}"
            self._clear(name)
            names = {n: f"{name}/{n}" if n > 1 else name for n in range(1, samples + 1)}
        else:
            prompt = trained.prompt(prompt)
            # The first n of which not all are there lacks its last.
            free = next(n for n in count(1) if not self.has_rewards(flavour, n))
            names = {free: f"reward/{cameras}/{flavour}/revised/{free}"}
        failed, paths = [], []
        for sample, name in names.items():
            file, conversation = self._reward_file(flavour, sample), self._begin(name)
            try:
                source = writing.write_program(conversation, rules, prompt, first)
            except NoAnswerError as error:
                failed.append(str(error))
                continue
            finally:
                if rows := writing.rows_of(conversation):
                    lines = "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows)
                    self._files.write(str(file.with_suffix(".attempts.jsonl")), lines)
            paths.append(self._files.write(str(file), source))
        if failed:
            raise NoAnswerError("; ".join(failed))
        return paths

    def has_rewards(self, flavour: str, samples: int) -> bool:
        """Whether all samples of a reward for the settings' cameras exist."""
        files = (self._reward_file(flavour, n) for n in range(1, samples + 1))
        return all((self.folder / file).exists() for file in files)

    def _reward_file(self, flavour: str, sample: int) -> Path:
        return Path("rewards", "+".join(self._settings.cams), file_name(flavour, sample))

    def _begin(self, name: str) -> Conversation:
        return Conversation(self.record, name, self._config.attempts)

    def _album(self, sets: Sequence[str] = ()) -> Album:
        """Of the scene's cameras, or of those of ``sets`` alone."""
        settings = questions.narrowed(self._settings, sets) if sets else self._settings
        return open_album(self.record, settings, self._config.size)

    def _clear(self, *conversations: str, files: Sequence[str] = ()) -> None:
        """With ``overwrite``, retire old answers. A replay keeps them: it can give no others."""
        if self._config.overwrite and self._live:
            self.record.retire(conversations)
            for name in files:
                self._files.vacate(name)

    def _write(self, name: str, result: dict[str, Any]) -> dict[str, Any]:
        """Write results with their models and their cost. A replay writes the same file."""
        models = dict.fromkeys(f"{e.provider} {e.answered_by}" for e in self.record.used)
        whole = {**result, "models": [*models], "totals": totals_of(self.record.used)["all"]}
        self._files.write(name, json.dumps(whole, indent=2, ensure_ascii=False) + "\n")
        return whole
