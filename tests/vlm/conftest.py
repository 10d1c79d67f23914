"""A server on this machine that answers as models do, and the words of a command that asks it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from vlm_server import KEY, Server, by_schema, live, serve


@pytest.fixture(scope="session")
def running() -> Iterator[Server]:
    with serve() as server:
        yield server


@pytest.fixture
def server(running: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Server:
    """As it was at first, beside an empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    for name in ("GEMINI_API_KEY", "OPENAI_API_KEY", "TEST_KEY"):
        monkeypatch.setenv(name, KEY)
    running.script, running.requests, running.headers, running.paths = [], [], [], []
    running.otherwise = by_schema
    return running


@pytest.fixture
def words(server: Server) -> list[str]:
    return live(server)
