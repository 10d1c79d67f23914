"""What more cores would bring, by Amdahl's law."""

from __future__ import annotations

PREDICTED = (4, 8, 16, 64)
"""Numbers of cores that rates are predicted for."""


def serial_share(ratio: float, threads: int) -> float:
    """Share of the time on one thread that does not shrink, from a measured speed-up.

    Args:
        ratio: rate with ``threads`` over the rate with one.
        threads: at least 2.
    """
    return min(1.0, max(0.0, (threads / ratio - 1.0) / (threads - 1.0)))


def predict(rate: float, serial: float) -> dict[str, int]:
    """Rates by number of cores, from the rate on one and the share that does not shrink."""
    return {str(n): round(rate / (serial + (1.0 - serial) / n)) for n in PREDICTED}
