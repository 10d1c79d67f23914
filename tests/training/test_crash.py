"""A run that is killed leaves nothing half-made and goes on to the same bits."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tiny_runs import PLACE, TINY, composed, outcome, run_composed

RUN = Path("results") / PLACE


class KilledError(BaseException):
    """The process is no more: nobody handles this."""


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.8, 0.97])
def test_a_run_killed_while_it_writes_goes_on_to_the_same_bits(share, tmp_path, monkeypatch):
    values = composed(*TINY, "existing=resume", "results=results")
    real, written = os.fsync, []

    def counted(file: int) -> None:
        written.append(file)
        real(file)

    (tmp_path / "whole").mkdir()
    monkeypatch.chdir(tmp_path / "whole")
    monkeypatch.setattr(os, "fsync", counted)
    run_composed(values)
    expected, last = outcome(RUN), int(share * len(written))
    written.clear()

    def killed(file: int) -> None:
        if len(written) >= last:
            raise KilledError
        counted(file)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "fsync", killed)
    with pytest.raises(KilledError):
        run_composed(values)
    monkeypatch.setattr(os, "fsync", real)
    run_composed(values)
    assert outcome(RUN) == expected
    assert [path.name for path in RUN.parent.iterdir()] == ["seed0"]
