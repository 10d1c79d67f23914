"""Episodes for other learners: who demonstrates, and the layouts of the datasets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from needlehoop.config.strict import check_names

FORMATS = ("minari", "lerobot")


def layout(name: str) -> Callable[..., Any]:
    """What writes datasets of a format; see ``write`` in ``minari_layout`` and ``lerobot_layout``.

    It takes an empty folder, the episodes, and what the dataset says of itself: the environment's
    settings, who demonstrated, and its provenance (commit, versions, machine, time).

    Raises:
        ValueError: an unknown format, or one whose library is not installed.
    """
    check_names("format", [name], FORMATS)
    try:
        if name == "minari":
            from needlehoop.demonstrations.minari_layout import write
        else:
            from needlehoop.demonstrations.lerobot_layout import write
    except ModuleNotFoundError as error:
        raise ValueError(
            f"format={name} needs {error.name}: pip install 'needlehoop[{name}]'"
        ) from error
    return write
