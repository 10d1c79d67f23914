"""Studies without drawings, for tests of pages and commands."""

import pytest

from needlehoop.study.render import figures
from needlehoop.study.render.style import new_figure


@pytest.fixture
def sketched(monkeypatch):
    """Draw every figure with nothing in it."""
    for name, (_, caption) in figures._DRAWN.items():
        monkeypatch.setitem(figures._DRAWN, name, (lambda _: new_figure(20)[0], caption))
