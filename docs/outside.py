"""What the site shows from outside ``docs/``, for mkdocs.

Pages are read in the repository as well, where ``../results/README.md`` leads somewhere. On the
site, a picture out there is brought in, and any other link is left as its text. The home page is
the first part of ``README.md``, so that it is written once.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

HOME_ENDS = "<!-- The site's home page ends here. -->"
_PICTURE = re.compile(r"(!\[[^]]*]\()\.\./([^)]+)\)")
_LINK = re.compile(r"\[([^]]+)]\(\.\./[^)]+\)")


def home(readme: str) -> str:
    """The home page: the README as far as ``HOME_ENDS``, its links as ``docs/`` has them.

    Raises:
        ValueError: the README does not say where the home page ends.
    """
    page, mark, _ = readme.partition(HOME_ENDS)
    if not mark:
        raise ValueError(f"README.md lacks the line {HOME_ENDS}")
    return re.sub(r"]\((?!https?:)", "](../", page).replace("](../docs/", "](")


def on_files(files: Files, config: Any) -> Files:
    """Add the home page, and the pictures that pages show from outside.

    Raises:
        FileNotFoundError: a picture that is not there.
        ValueError: as in ``home``.
    """
    root = Path(config.docs_dir).parent
    content = home((root / "README.md").read_text())
    files.append(File.generated(config, "index.md", content=content))
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
