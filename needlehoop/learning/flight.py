"""A run's job as its agent is flown: with the run's own settings, or with some of them changed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from needlehoop import rewards
from needlehoop.config.changing import changed
from needlehoop.envs.settings import recall_task
from needlehoop.learning.job import Job, checked_job
from needlehoop.learning.weights import Senses, check_same


def flown_job(
    recorded: Mapping[str, Any], words: Iterable[str], trust: bool, command: str | None = None
) -> tuple[Job, dict[str, Any]]:
    """The job of a run's config, its environment changed by words, and what was changed.

    Args:
        words: as on the command line; none change nothing.
        trust: whether Python code that the run's files name may run. A reward that is typed may.

    Returns:
        The job; and new values by their key, such as ``episode.grasp``.

    Raises:
        ValueError: code without ``trust``, a word that is wrong, or one that changes what the
            agent's networks were made for.
    """
    given = list(words)
    recall_task(recorded, trust)
    own = checked_job(recorded)
    values, found = changed(recorded, given, command)
    job = checked_job(values)
    check_same(Senses.of(own), Senses.of(job), ", ".join(found))
    is_typed = any(word.lstrip("+").startswith("reward=") for word in given)
    paid = rewards.allow(job.env.reward) if is_typed else rewards.recall(job.env.reward, trust)
    return replace(job, env=replace(job.env, reward=paid)), found
