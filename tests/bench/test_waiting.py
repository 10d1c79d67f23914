"""The bar of a measurement."""

import io

from needlehoop.bench import waiting


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_bar_counts_rounds_where_somebody_watches(monkeypatch):
    for stream, drawn in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr("sys.stderr", stream)
        assert [*waiting.rounds_of(3, "buffer")] == [0, 1, 2]
        assert ("measuring" in stream.getvalue()) == drawn
