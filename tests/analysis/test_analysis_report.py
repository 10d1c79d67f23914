"""The report of all studies opens with the findings."""

from pathlib import Path

from analysis.report import as_html

PNG = b"\x89PNG\r\n\x1a\n"


def test_a_page_holds_its_pictures_and_its_links_lead_on(tmp_path: Path):
    docs, results = tmp_path / "docs", tmp_path / "results"
    docs.mkdir()
    (docs / "dots.png").write_bytes(PNG)
    page = docs / "findings.md"
    page.write_text("# Found\n\nSee [more](evidence.md).\n\n![Some dots](dots.png)\n")
    html = as_html(page, results)
    assert "<h1>Found</h1>" in html
    assert '<a href="../docs/evidence.md">more</a>' in html
    assert '<img src="data:image/png;base64,' in html
    assert 'alt="Some dots"' in html
