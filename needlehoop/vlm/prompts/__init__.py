"""The texts that a model is shown, as files, and how their gaps are filled."""

from __future__ import annotations

from importlib.resources import files
from string import Template


def fill(name: str, **values: object) -> str:
    """The prompt ``<name>.txt`` with its ``$gaps`` filled.

    Raises:
        ValueError: gaps and values are not the same.
    """
    template = Template(files(__name__).joinpath(f"{name}.txt").read_text(encoding="utf-8"))
    gaps = set(template.get_identifiers())
    if gaps != set(values):
        odd = ", ".join(sorted(gaps ^ set(values)))
        raise ValueError(f"prompt {name}: {odd} missing or not asked for")
    return template.substitute({key: str(value) for key, value in values.items()}).strip()
