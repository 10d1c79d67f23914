"""Episodes for other learners: who demonstrates, and the layouts of the datasets."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from typing import Any

from needlehoop.config.strict import check_names


def layout(name: str, dataset: str) -> Callable[..., Any]:
    """What writes datasets of a format; see ``write`` in ``minari_layout`` and ``lerobot_layout``.

    It takes an empty folder, the episodes, and what the dataset says of itself: the environment's
    settings, who demonstrated, and its provenance (commit, versions, machine, time).

    Args:
        dataset: the name of its folder.

    Raises:
        ValueError: an unknown format, one whose library is not installed, or a folder's name that
            is no dataset's id for Minari.
    """
    check_names("format", [name], ("minari", "lerobot"))
    try:
        found = import_module(f"needlehoop.demonstrations.{name}_layout")
    except ModuleNotFoundError as error:
        raise ValueError(
            f"format={name} needs {error.name}: pip install 'needlehoop[{name}]'"
        ) from error
    if name == "minari" and not re.fullmatch(r"[\w.-]+-v\d+", dataset):
        raise ValueError(
            f"out: {dataset!r} is no name for Minari, which wants a version: such as smooth-v0"
        )
    return found.write
