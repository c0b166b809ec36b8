# SPDX-License-Identifier: Apache-2.0
"""The table of the paper's equations (1)-(37): where each is used and tested, by docstrings that cite it."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pam_orthosis
from generators.markdown import WIDE, table

PACKAGE = Path(pam_orthosis.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
MEANING = {
    1: "motion of the rig's carriage",
    2: "contraction of the positioning muscle",
    3: "polytropic process in a muscle",
    4: "its total differential",
    5: "ideal gas",
    6: "pressure of a muscle: mass flow in, volume's change out",
    7: "state space of the carriage",
    8: "force of the positioning muscle",
    9: "its time derivative",
    10: "three differentiations until the mass flow shows: relative degree 3",
    11: "linearising mass flow",
    12: "stabilising input, pole placement",
    13: "muscle: spring force less damping",
    14: "spring force: area function times pressure less counterforce",
    15: "volume: cylinder and two frustums",
    16: "volume polynomial, DMSP-10",
    17: "volume polynomial, DMSP-20",
    18: "damping from the decay of a free oscillation",
    19: "model force, linear in the coefficients",
    20: "model error",
    21: "quadratic performance index",
    22: "its gradient vanishes",
    23: "least-squares coefficients",
    24: "hip angle of a knee angle",
    25: "Lagrange's equation",
    26: "equation of motion of the knee",
    27: "torque of the pair of muscles",
    28: "state space of the knee, pressures as inputs",
    29: "states of the observer",
    30: "its measurement",
    31: "the observer",
    32: "its error system, pole placement",
    33: "error of the angle",
    34: "first Lyapunov function",
    35: "its derivative made negative",
    36: "error of the velocity",
    37: "derivative of the second one made negative: the control law",
}
_CITED = re.compile(r"Eqs?\.\s*(\(\d+\)(?:(?:,\s*|\s*-\s*|\s+and\s+|\s+to\s+|,\s+and\s+)\(\d+\))*)")
_SENTENCE = re.compile(r"(?<!Eq)(?<!Eqs)[.;]\s+(?=\S)")
PRINTS = ") prints "  # is said of an equation that is used otherwise
_PART = re.compile(r"\((\d+)\)|(-|\bto\b)")


class Citation(NamedTuple):
    """A docstring that cites an equation: dotted place below the package, the sentence that cites it."""

    place: str
    words: str


def cited(docstring: str) -> set[int]:
    """Return the numbers of the equations that a docstring cites, ranges filled."""
    numbers: set[int] = set()
    for found in _CITED.finditer(docstring):
        last, through = 0, False
        for number, dash in _PART.findall(found[1]):
            if dash:
                through = True
                continue
            numbers |= set(range(last + 1, int(number))) if through else set()
            numbers.add(int(number))
            last, through = int(number), False
    return numbers


def sentence(docstring: str, number: int) -> str:
    """Return the first sentence of a docstring that cites an equation."""
    return " ".join(next(part for part in _sentences(docstring) if number in cited(part)).split())


def _sentences(docstring: str) -> list[str]:
    return [part for paragraph in docstring.split("\n\n") for part in _SENTENCE.split(paragraph)]


def citations() -> dict[int, list[Citation]]:
    """Return equation number -> citations by functions and classes; what a whole module says is no place."""
    found = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        if module.split(".")[0] in ("cli", "report", "nodes"):
            continue
        for name, docstring in _docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            for number in cited(docstring):
                found[number].append(Citation(f"{module}.{name}", sentence(docstring, number)))
    return {number: found[number] for number in MEANING}


def mended() -> list[Citation]:
    """Return what docstrings say of equations that are not used as the paper prints them."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for name, docstring in _docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            sentences = (" ".join(part.split()) for part in _sentences(docstring))
            found += [Citation(f"{module}.{name}", words) for words in sentences if PRINTS in words]
    return sorted(found, key=lambda one: min(cited(one.words)))


def tests() -> dict[int, list[str]]:
    """Return equation number -> tests that cite it, as pytest names them."""
    found = defaultdict(list)
    for path in sorted((ROOT / "test").rglob("test_*.py")):
        for name, docstring in _docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            for number in cited(docstring) if name.startswith("test_") else ():
                found[number].append(f"{path.relative_to(ROOT)}::{name}")
    return {number: found[number] for number in MEANING}


def _docstrings(tree: ast.Module, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield name and docstring of all public or private functions and classes in a module."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            if words := ast.get_docstring(node):
                yield f"{prefix}{node.name}", words
            if isinstance(node, ast.ClassDef):
                yield from _docstrings(node, f"{node.name}.")


def of_modules(modules) -> list[tuple[str, Citation]]:
    """Return (number, citation) of the equations that some modules cite, by number."""
    return [
        (str(number), one)
        for number, found in citations().items()
        for one in found
        if any(one.place == m or one.place.startswith(f"{m}.") for m in modules)
    ]


def pages() -> dict[str, str]:
    """Return the page."""
    tested = tests()
    rows = [
        (
            f"({number})", MEANING[number], "<br>".join(f"`{one.place}`: {one.words}" for one in found),
            "<br>".join(f"`{name}`" for name in tested[number]),
        )
        for number, found in citations().items()
    ]  # fmt: skip
    head = (
        "# The paper's equations in the code\n\nThe functions and classes that use each equation, with what"
        " their docstrings say about it, and the tests that cite it."
        " [Model and equations](../explanation/model.md) puts them in order.\n\n"
    )
    return {
        "reference/equations.md": WIDE
        + head
        + table(("equation", "what it says", "where", "tests"), rows)
        + "\n## Not used as they are printed\n\n"
        + table(("where", "what"), [(f"`{one.place}`", one.words) for one in mended()])
    }
