# SPDX-License-Identifier: Apache-2.0
"""What `mkdocs` does beside the plain thing: order of the pages, names of the repository's files."""

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parent
FIRST = ("index", "tutorial", "paper", "control", "identification")
FOLDERS = {"nodes": "Nodes", "effects": "Effects", "parameters": "Parameters"}
_OUTSIDE = re.compile(r"\[([^\]]+)\]\((\.\./[^)#]+)\)")


def on_config(config):
    """Order the navigation: the pages by hand, the generated folders last."""
    pages = sorted(path.stem for path in DOCS.glob("*.md"))
    ordered = [name for name in FIRST if name in pages] + [name for name in pages if name not in FIRST]
    config.nav = [f"{name}.md" for name in ordered]
    for folder, title in FOLDERS.items():
        names = sorted(path.name for path in (DOCS / folder).glob("*.md") if path.stem != "index")
        config.nav.append({title: [f"{folder}/index.md", *(f"{folder}/{name}" for name in names)]})
    return config


def on_page_markdown(markdown, page, **_):
    """Turn links to files outside of docs/ into their names: they are not part of the site.

    Raises:
        FileNotFoundError: there is no such file.
    """
    here = (DOCS / page.file.src_uri).parent

    def named(found):
        target = (here / found[2]).resolve()
        if target.is_relative_to(DOCS):
            return found[0]
        if not target.exists():
            raise FileNotFoundError(f"{page.file.src_uri} speaks of {found[2]}")
        return f"{found[1]} (`{target.relative_to(DOCS.parent)}`)"

    return _OUTSIDE.sub(named, markdown)
