"""Providers by their kind."""

from __future__ import annotations

from needlehoop.vlm.providers.contract import LiveConfig, Provider


def build_provider(config: LiveConfig) -> Provider:
    """A provider by its kind; nothing is sent yet.

    Raises:
        ValueError: an unknown kind, or no key.
        RuntimeError: its package is not installed.
    """
    if config.kind == "gemini":
        from needlehoop.vlm.providers.gemini import Gemini

        return Gemini(config)
    if config.kind == "openai":
        from needlehoop.vlm.providers.compatible import Compatible

        return Compatible(config)
    raise ValueError(f"vlm.kind: {config.kind!r} is unknown; choose from replay, gemini, openai")
