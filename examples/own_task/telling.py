"""The task in words, for a vision-language model."""

from pathlib import Path
from typing import Any

from needlehoop.tasks.contract import Telling
from needlehoop.tasks.layout import lengths, millimetres


def values(layout: Any, rules: Any) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    return {
        **lengths(layout),
        "half": millimetres(layout.cube / 2),
        "height": millimetres(layout.tool_position[2]),
        "open": f"{layout.open:g}",
        "control": f"moves the gripper by up to {millimetres(rules.translation)} mm along each of"
        f" x, y and z, and opens or closes each finger by up to {millimetres(rules.grip)} mm",
    }


TELLING = Telling(
    texts=Path(__file__).parent / "prompts",
    values=values,
    goal="the cube lies on the spot, let go",
    done="the cube is where it has to be",
    front="the table",
    moments={"held": "both fingers hold the cube"},
)
