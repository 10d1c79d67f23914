"""A server on this machine that answers as models do, and the words of a command that asks it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from vlm_server import KEY, Server, by_schema, serve


@pytest.fixture(scope="session")
def running() -> Iterator[Server]:
    with serve() as server:
        yield server


@pytest.fixture
def server(running: Server, elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> Server:
    """As it was at first, beside an empty folder to work in; nobody waits between two tries."""
    monkeypatch.setattr(time, "sleep", lambda _: None)
    for name in ("GEMINI_API_KEY", "OPENAI_API_KEY", "TEST_KEY"):
        monkeypatch.setenv(name, KEY)
    running.script, running.requests, running.headers = [], [], []
    running.otherwise = by_schema
    return running


@pytest.fixture
def words(server: Server) -> list[str]:
    """The words of a command that asks it as Gemini."""
    return ["vlm=gemini", f"vlm.base_url={server.url}", "size=16"]
