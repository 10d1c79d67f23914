"""Signals while a run is under way."""

import os
import signal
from collections.abc import Iterator

import pytest

from needlehoop.runs.machine import interruption

KINDS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[list[object]]:
    """Python's own Ctrl-C and a SIGTERM that does not end the test, whoever runs it."""

    def harmless(number, frame):
        raise SystemExit(number)

    before = [signal.getsignal(kind) for kind in KINDS]
    ours = [signal.default_int_handler, harmless]
    for kind, handler in zip(KINDS, ours, strict=True):
        signal.signal(kind, handler)
    yield ours
    for kind, handler in zip(KINDS, before, strict=True):
        signal.signal(kind, handler)


def installed() -> list[object]:
    return [signal.getsignal(kind) for kind in KINDS]


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_signal_only_asks(kind, handlers, capsys):
    with interruption() as stop_request:
        assert not stop_request.is_set()
        os.kill(os.getpid(), kind)
        assert stop_request.is_set()
    assert "once more to stop at once" in capsys.readouterr().err
    assert installed() == handlers


@pytest.mark.parametrize(
    ("second", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_the_second_acts_at_once_and_the_handlers_are_put_back(second, raised, handlers):
    def signalled() -> None:
        with interruption():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(second)

    with pytest.raises(raised):
        signalled()
    assert installed() == handlers
