"""The task in words, for a vision-language model."""

from pathlib import Path
from typing import Any

from needlehoop.tasks.contract import Telling


def values(layout: Any, rules: Any) -> dict[str, object]:
    """What fills the gaps of ``prompts/*.txt``, by name."""
    lengths = {"edge": layout.cube, "half": layout.cube / 2, "spot": layout.spot}
    lengths["height"] = layout.tool_position[2]
    return {
        **{name: f"{1000 * length:g}" for name, length in lengths.items()},
        "open": f"{layout.open:g}",
        "control": f"moves the gripper by up to {1000 * rules.translation:g} mm along each of x,"
        f" y and z, and opens or closes each finger by up to {1000 * rules.grip:g} mm",
    }


TELLING = Telling(
    texts=Path(__file__).parent / "prompts",
    values=values,
    goal="the cube lies on the spot, let go",
    done="the cube is where it has to be",
    front="the table",
    moments={"held": "both fingers hold the cube"},
)
