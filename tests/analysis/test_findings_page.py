"""What docs/evidence.md says is what the runs in results/ gave; the report holds the findings."""

import json
from pathlib import Path

import pytest

from analysis import findings as analysis
from analysis.report import as_html

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "evidence.md").read_text()


def test_a_refilled_page_is_the_page():
    assert analysis.refilled(PAGE) == PAGE
    with pytest.raises(ValueError, match=r"evidence\.md: no table claims"):
        analysis.refilled(PAGE.replace("<!-- claims", "<!-- nothing"))


def test_success_by_seed_is_what_evaluations_say():
    seeds: dict[str, list[str]] = {}
    for path in sorted((ROOT / "results" / "fast").glob("*/*/*/evaluation.json")):
        share = json.loads(path.read_text())["success"]
        seeds.setdefault(path.parts[-4], []).append(f"{100 * share:.0f}")
    rows = PAGE.partition("<!-- results -->\n")[2].partition("\n\n")[0].splitlines()[2:]
    shown = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert {row[0]: row[2] for row in shown} == {
        name: ", ".join(own) for name, own in seeds.items()
    }


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
