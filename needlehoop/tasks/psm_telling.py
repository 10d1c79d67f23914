"""The PSM's part in how a task is told to a model."""

from __future__ import annotations

from needlehoop.tasks.episode import ArmEpisode, ToolEpisode
from needlehoop.tasks.layout import ArmLayout, lengths, millimetres

_CONTROLS = {
    "tip": "moves the tip of the instrument by up to {move} mm along each of x, y and z, turns it"
    " by up to {turn} rad about its own axis, and opens or closes the jaws by up to {jaw} rad",
    "pose": "moves the tip of the instrument by up to {move} mm along each of x, y and z, turns it"
    " by up to {turn} rad about each of them, and opens or closes the jaws by up to {jaw} rad",
}

_GRASPED = {
    "weld": "becomes true when both jaws touch the {thing} while jaw_command is below {close} rad;"
    " it stays so, without flicker, until jaw_command rises above {release} rad.",
    "friction": "becomes true when {part} is between the jaws and both touch it while"
    " jaw_command is below {close} rad; it becomes false when neither touches it any more, or when"
    " jaw_command rises above {release} rad, and may flicker.",
}


def arm_values(layout: ArmLayout, rules: ToolEpisode) -> dict[str, object]:
    """``control``, ``jaw_closed``, ``jaw_open``, ``jaw_start``, and ``lengths`` of the layout."""
    return {
        **lengths(layout),
        "control": _CONTROLS[rules.control].format(
            move=millimetres(rules.translation), turn=f"{rules.rotation:g}", jaw=f"{rules.jaw:g}"
        ),
        "jaw_closed": f"{layout.jaw_closed:g}",
        "jaw_open": f"{layout.jaw_open:g}",
        "jaw_start": f"{layout.tool_jaw:g}",
    }


def grasped(rules: ArmEpisode, thing: str, part: str | None = None) -> str:
    """When the jaws hold a thing; ``part`` is what is between them, ``None`` for all of it."""
    return _GRASPED[rules.grasp].format(
        thing=thing,
        part=part or f"the {thing}",
        close=f"{rules.close_below:g}",
        release=f"{rules.release_above:g}",
    )
