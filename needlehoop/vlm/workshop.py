"""The language of rewards and its judge, as the conversation about them needs both."""

from __future__ import annotations

from needlehoop.envs.settings import Settings
from needlehoop.rewards.language.functions import FUNCTIONS
from needlehoop.rewards.language.grammar import ProgramError
from needlehoop.rewards.language.program import compile_program
from needlehoop.vlm.card import CHEATING, card, values_of
from needlehoop.vlm.gates import Gates
from needlehoop.vlm.moments import collect
from needlehoop.vlm.writing import Verdict, Workshop

_RESULT = (
    "The program's value is what it last assigns to the variable reward. Assigned names may not be"
    " those of signals or functions."
)


def open_workshop(settings: Settings, gates: Gates) -> Workshop:
    """What a model is told of the language, and the gates as its judge.

    Args:
        settings: the environment in which the gates' trajectories are recorded, once.
        gates: what is asked of a program.
    """
    trajectories = collect(settings, gates)

    def judge(source: str) -> Verdict:
        try:
            program = compile_program(source)
        except ProgramError as error:
            return Verdict(False, str(error), {})
        found = card(program, settings, gates, trajectories)
        # What a cheat would be says what success is, and that no model is told.
        told = "; ".join(found.reasons).replace(CHEATING, "an episode that fails at the task")
        return Verdict(found.passed, told, found.as_dict())

    def values(source: str) -> list[float]:
        return values_of(compile_program(source), trajectories, gates).tolist()

    return Workshop(
        functions={name: (f.signature, f.meaning) for name, f in FUNCTIONS.items()},
        result=_RESULT,
        lowest=gates.low,
        highest=gates.high,
        judge=judge,
        values=values,
    )
