"""Signals while a run is under way."""

import os
import signal
from collections.abc import Iterator

import pytest

from needlehoop.runs.interruption import Interruption

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
def test_the_first_signal_only_asks(kind, capsys):
    with Interruption() as interruption:
        assert not interruption.asked
        os.kill(os.getpid(), kind)
        assert interruption.asked
    assert "once more to stop at once" in capsys.readouterr().err


@pytest.mark.parametrize("first", KINDS)
def test_the_second_ctrl_c_acts_at_once(first):
    with Interruption() as interruption:
        signal.raise_signal(first)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert interruption.asked


def test_a_sigterm_after_a_ctrl_c_acts_at_once():
    with Interruption():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(SystemExit):
            signal.raise_signal(signal.SIGTERM)


def test_the_handlers_are_put_back_when_nothing_happened(handlers):
    with Interruption() as interruption:
        assert all(ours is not found for ours, found in zip(handlers, installed(), strict=True))
    assert installed() == handlers
    assert not interruption.asked


def test_the_handlers_are_put_back_after_a_signal(handlers):
    with Interruption():
        signal.raise_signal(signal.SIGTERM)
    assert installed() == handlers


def test_the_handlers_are_put_back_after_an_error_that_passes_through(handlers):
    def fail():
        with Interruption():
            raise OSError("disk")

    with pytest.raises(OSError, match="disk"):
        fail()
    assert installed() == handlers
