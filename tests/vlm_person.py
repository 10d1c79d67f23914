"""Somebody at a chat window: answers every question of ``vlm=manual``; a process of its own.

``python vlm_person.py FOLDER`` watches ``FOLDER/asked`` and writes answers of the right form,
in turns as JSON and as a model's talk around it, until FOLDER/enough is there.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from vlm_server import by_schema


def answer(question: Path, number: int) -> None:
    """Answer a question from what is in its folder."""
    said = by_schema(json.loads((question / "schema.json").read_text()))
    if number % 2:
        talk = f"Let me see.\n\n```json\n{said}\n```\n\nShall I go on?\n"
        (question / "answer.md").write_text(talk)
    else:
        (question / "answer.json").write_text(said)


def main(folder: Path) -> None:
    """Until told that it is enough."""
    answered: set[tuple[str, int]] = set()
    while not (folder / "enough").exists():
        for request in sorted(folder.glob("asked/*/request.md")):
            # Asked once more, a question has a folder of the same name and another file in it.
            key = request.parent.name, request.stat().st_ino
            if key not in answered:
                answer(request.parent, len(answered))
                answered.add(key)
        time.sleep(0.01)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
