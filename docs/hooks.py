# SPDX-License-Identifier: Apache-2.0
"""What `mkdocs` does beside the plain thing: generated pages, generated tables in pages, their navigation."""

import re
import sys
from pathlib import Path

from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).resolve().parent))

from generators import blocks, pages

BLOCK = re.compile(r"^<!-- table: ([\w-]+) -->$", flags=re.M)
FOLDER = "/*"  # ends an entry of the navigation that stands for all pages of a folder


def on_config(config):
    """Put the generated pages of a folder where the navigation names it."""
    config.made = pages()
    config.nav = _expanded(config.nav, sorted(config.made))
    return config


def on_files(files, config):
    """Add the generated pages."""
    for path, text in config.made.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown, page, **_):
    """Put generated tables where the page names them.

    Raises:
        KeyError: there is no such table.
    """
    makers = blocks()
    return BLOCK.sub(lambda found: makers[found[1]](), markdown)


def _expanded(entry, made):
    if isinstance(entry, dict):
        return {title: _expanded(one, made) for title, one in entry.items()}
    if not isinstance(entry, list):
        return entry
    found = []
    for one in entry:
        if isinstance(one, str) and one.endswith(FOLDER):
            folder = one.removesuffix("*")
            found += [path for path in made if path.startswith(folder) and path != f"{folder}index.md"]
        else:
            found.append(_expanded(one, made))
    return found
