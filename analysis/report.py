"""Builds results/report.html: the findings, then every study. ``python -m analysis.report``."""

from __future__ import annotations

import os
from pathlib import Path

from markdown_it import MarkdownIt

from analysis.findings import ROOT, STUDIES, study
from needlehoop.study.render.figures import draw
from needlehoop.study.report.page import inline, write_report

OUT = ROOT / "results" / "report.html"


def as_html(page: Path, beside: Path) -> str:
    """A page of docs/ as HTML that holds its pictures; links start from the folder ``beside``."""
    parser = MarkdownIt()
    tokens = parser.parse(page.read_text())
    for inner in (child for token in tokens for child in token.children or ()):
        if inner.type == "image":
            inner.attrSet("src", inline(page.parent / str(inner.attrGet("src"))))
        elif inner.type == "link_open":
            target = page.parent / str(inner.attrGet("href"))
            inner.attrSet("href", os.path.relpath(target, beside))
    return parser.renderer.render(tokens, parser.options, {})


def main() -> None:
    """Write the page."""
    figures = OUT.parent / "figures"
    parts = [(study(name), draw(study(name), figures / name)) for name in STUDIES]
    opening = as_html(ROOT / "docs" / "findings.md", OUT.parent)
    write_report(parts, OUT, "python -m analysis.report", opening)
    print(OUT)


if __name__ == "__main__":
    main()
