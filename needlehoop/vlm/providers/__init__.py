"""Those who answer: models behind servers, or a person with a chat window."""

from __future__ import annotations

from pathlib import Path

from needlehoop.vlm.config import AskingConfig, ManualConfig
from needlehoop.vlm.messages import Provider


def build_provider(config: AskingConfig, folder: Path) -> Provider:
    """A provider by its kind. It sends nothing yet; errors as in ``Server``.

    ``folder`` is the study's record, for providers that ask by files.
    """
    if isinstance(config, ManualConfig):
        from needlehoop.vlm.providers.manual import Manual

        return Manual(config, folder)
    from needlehoop.vlm.providers.server import Server

    return Server(config)
