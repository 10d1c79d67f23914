"""What the pages' tables say is what the runs in results/ gave; the report holds the findings."""

import pytest

from analysis import findings as analysis
from analysis.report import as_html


@pytest.mark.parametrize("name", analysis.TABLES)
def test_a_refilled_page_is_the_page(name):
    page = (analysis.DOCS / name).read_text()
    assert analysis.refilled(name, page) == page
    marker = next(iter(analysis.TABLES[name]()))
    with pytest.raises(ValueError, match=f"{name}: no table {marker}"):
        analysis.refilled(name, page.replace(f"<!-- {marker}", "<!-- nothing"))


def test_a_page_holds_its_pictures_and_its_links_lead_on(tmp_path):
    docs, results = tmp_path / "docs", tmp_path / "results"
    docs.mkdir()
    (docs / "dots.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    page = docs / "findings.md"
    page.write_text("# Found\n\nSee [more](evidence.md).\n\n![Some dots](dots.png)\n")
    html = as_html(page, results)
    assert "<h1>Found</h1>" in html
    assert '<a href="../docs/evidence.md">more</a>' in html
    assert '<img src="data:image/png;base64,' in html
