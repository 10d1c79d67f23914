"""Those who answer: models behind servers, or a person with a chat window."""

from __future__ import annotations

from pathlib import Path

from needlehoop.vlm.providers.contract import AskingConfig, ManualConfig, Provider


def build_provider(config: AskingConfig, folder: Path) -> Provider:
    """A provider by its kind. It sends nothing yet; errors as in ``SdkProvider``.

    ``folder`` is the study's record, for providers that ask by files.
    """
    if isinstance(config, ManualConfig):
        from needlehoop.vlm.providers.manual import Manual

        return Manual(config, folder)
    if config.kind == "gemini":
        from needlehoop.vlm.providers.gemini import Gemini

        return Gemini(config)
    from needlehoop.vlm.providers.compatible import Compatible

    return Compatible(config)
