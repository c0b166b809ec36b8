# SPDX-License-Identifier: Apache-2.0
"""The one design of all pages: the verdict first, what it means, then parts with tables and plots.

A page is one HTML file that needs nothing but itself.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pam_orthosis import __version__
from pam_orthosis.markup import table
from pam_orthosis.report.plots import Plot

PACKAGE = "pam_orthosis.report"
GOOD, BAD, NEUTRAL = "good", "bad", "neutral"  # tone of an answer


class Moving(NamedTuple):
    """A machine that moves: what it shows, in words, and what `assets/player.js` draws."""

    alt: str
    data: Mapping[str, Any]


class Picture(NamedTuple):
    """A picture that a page holds: what it shows, in words, and PNG."""

    alt: str
    png: bytes

    @property
    def source(self) -> str:
        """The picture as the address of an image."""
        return f"data:image/png;base64,{b64encode(self.png).decode()}"


class Part(NamedTuple):
    """A part of a page, whatever of it there is, in this order; `pre` is folded away under `more`."""

    title: str
    words: Sequence[str] = ()
    table: Markup | None = None
    machine: Moving | None = None
    plots: Sequence[Plot] = ()
    pictures: Sequence[Picture] = ()
    pre: str = ""
    more: str = ""


class Page(NamedTuple):
    """A page.

    Attributes:
        title: what it is on.
        answer: the verdict in a word or two.
        tone: `GOOD`, `BAD` or `NEUTRAL`.
        headline, meaning: the verdict in a sentence, what it means in paragraphs.
        parts: the rest.
        about: what kind of page it is.
    """

    title: str
    answer: str
    tone: str
    headline: str
    meaning: Sequence[str]
    parts: Sequence[Part]
    about: str

    def html(self) -> str:
        """Return the page."""
        plots, machines = (any(getattr(part, kind) for part in self.parts) for kind in ("plots", "machine"))
        return rendered("page.html", page=self, title=self.title, plots=plots, machines=machines)


def rendered(template: str, **given: Any) -> str:
    """Return a template of the package with what it is given."""
    return _environment().get_template(template).render(version=__version__, **given)


def listed(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """Return a table of texts."""
    return Markup(table(head, rows))


def asset(name: str) -> Markup:
    """Return the text of a style sheet or script that comes with the package."""
    return Markup((files(PACKAGE) / "assets" / name).read_text(encoding="utf-8"))


@cache
def _environment() -> Environment:
    made = Environment(loader=PackageLoader(PACKAGE), autoescape=True, undefined=StrictUndefined)
    made.trim_blocks = made.lstrip_blocks = True
    made.globals["asset"] = asset
    return made
