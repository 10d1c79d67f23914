"""Links of the documentation to what lies outside ``docs/``, for mkdocs.

A page is read in the repository as well, where ``../results/README.md`` leads somewhere. On the
site, a picture out there is brought in, and any other link is left as its text.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

_PICTURE = re.compile(r"(!\[[^]]*]\()\.\./([^)]+)\)")
_LINK = re.compile(r"\[([^]]+)]\(\.\./[^)]+\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pictures that pages show from outside.

    Raises:
        FileNotFoundError: one that is not there.
    """
    root = Path(config.docs_dir).parent
    for page in files.documentation_pages():
        for _, name in _PICTURE.findall(page.content_string):
            if not (root / name).is_file():
                raise FileNotFoundError(f"{page.src_uri} shows {name}, which is not there")
            if files.get_file_from_path(name) is None:
                files.append(File.generated(config, name, abs_src_path=str(root / name)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A page's links as the site has them."""
    return _LINK.sub(r"\1", _PICTURE.sub(r"\1\2)", markdown))
