# SPDX-License-Identifier: Apache-2.0
"""Count how the package is built, a column each: `python benchmarks/structure.py [CHECKOUT ...]`."""

from __future__ import annotations

import ast
import re
import statistics
import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

PACKAGE = "pam_orthosis"
ROOMS = ("model", "control", "discrepancy", "bag")  # whose types are checked
ORACLE = "hidden"  # where testing/ was before
LONG = 350  # lines: a module that is longer has two jobs
NAMES = {
    "knee": r"(?i)knee",
    "dmsp_20": "dmsp_20",
    "extensor or flexor": r"(?i)extensor|flexor",
    "the knee's geometry": r"cogwheel|sprocket|symmetric_|bearing|thigh|shank|kinematics",
}
BY_TEXT = r"SimpleNamespace|[gs]etattr\([^()]*f[\"']|\.replace\([\"']"  # signals and effects by their text
BRANCHES = (
    ast.If,
    ast.For,
    ast.While,
    ast.IfExp,
    ast.ExceptHandler,
    ast.Assert,
    ast.comprehension,
    ast.match_case,
)
ARITHMETIC = (ast.Constant, ast.UnaryOp, ast.BinOp, ast.unaryop, ast.operator)
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Tree:
    """The package of a checkout, read once."""

    def __init__(self, checkout: Path):
        self._root = checkout / PACKAGE
        self.texts = {path: path.read_text(encoding="utf-8") for path in sorted(self._root.rglob("*.py"))}

    @cached_property
    def modules(self) -> dict[Path, ast.Module]:
        """Return the syntax tree of each module."""
        return {path: ast.parse(text) for path, text in self.texts.items()}

    @property
    def lines(self) -> list[str]:
        """Return all lines."""
        return [line for text in self.texts.values() for line in text.splitlines()]

    def functions(self, rooms: tuple[str, ...] = ()) -> list[Function]:
        """Return the functions and methods, of some rooms only if any are given, without the oracle."""
        of = [
            module
            for path, module in self.modules.items()
            if not rooms or (path.relative_to(self._root).parts[0] in rooms and path.parent.name != ORACLE)
        ]
        return [node for module in of for node in ast.walk(module) if isinstance(node, Function)]

    def matching(self, pattern: str) -> int:
        """Return the number of files in which a pattern occurs."""
        return sum(re.search(pattern, text) is not None for text in self.texts.values())


def rows(tree: Tree) -> Iterator[tuple[str, str]]:
    """Yield what is counted, and the number."""
    lines, functions, core = tree.lines, tree.functions(), tree.functions(ROOMS)
    lengths = [one.end_lineno - one.lineno + 1 for one in functions if one.end_lineno]
    yield "lines", f"{len(lines)}"
    yield "files", f"{len(tree.texts)}"
    yield (
        f"files of more than {LONG} lines",
        f"{sum(len(t.splitlines()) > LONG for t in tree.texts.values())}",
    )
    for name, pattern in NAMES.items():
        yield f"files that name {name}", f"{tree.matching(pattern)}"
    yield "names made of texts (namespace, getattr, replace)", f"{sum(map(_by_text, lines))}"
    yield "functions", f"{len(functions)}"
    yield "function length, lines: median", f"{statistics.median(lengths):.0f}"
    yield "function length, lines: 90 % below", f"{statistics.quantiles(lengths, n=10)[8]:.0f}"
    yield "function length, lines: largest", f"{max(lengths)}"
    yield "cyclomatic complexity, largest", f"{max(map(_complexity, functions))}"
    yield f"parameters without a type in {', '.join(ROOMS)}", f"{sum(map(_untyped, core))}"
    yield (
        "functions without a return type there",
        f"{sum(one.returns is None for one in core if _returns(one))}",
    )
    yield "numeric constants beside functions", f"{sum(map(_constants, tree.modules.values()))}"
    filled = [len(line) for line in lines if line.strip()]
    yield "characters a line that is not empty", f"{statistics.mean(filled):.1f}"
    yield (
        "tuple assignments in 1,000 lines",
        f"{1e3 * sum(map(_tuples, tree.modules.values())) / len(lines):.1f}",
    )


def _by_text(line: str) -> int:
    return len(re.findall(BY_TEXT, line))


def _complexity(function: Function) -> int:
    """Return McCabe's number: paths through a function, functions within it included."""
    nodes = list(ast.walk(function))
    jumps = sum(isinstance(node, BRANCHES) for node in nodes)
    return 1 + jumps + sum(len(node.values) - 1 for node in nodes if isinstance(node, ast.BoolOp))


def _untyped(function: Function) -> int:
    own = function.args
    named = [*own.posonlyargs, *own.args, *own.kwonlyargs, *filter(None, (own.vararg, own.kwarg))]
    return sum(one.annotation is None and one.arg not in ("self", "cls") for one in named)


def _returns(function: Function) -> bool:
    return function.name != "__init__"


def _constants(module: ast.Module) -> int:
    """Return the number of names at module level that stand for a number."""
    count = 0
    for node in module.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            count += sum(map(_number, values))
    return count


def _number(value: ast.expr) -> bool:
    parts = list(ast.walk(value))
    numbers = [type(one.value) in (int, float) for one in parts if isinstance(one, ast.Constant)]
    return bool(numbers) and all(numbers) and all(isinstance(one, ARITHMETIC) for one in parts)


def _tuples(module: ast.Module) -> int:
    nodes = (node for node in ast.walk(module) if isinstance(node, ast.Assign))
    return sum(isinstance(target, ast.Tuple) for node in nodes for target in node.targets)


def main() -> None:
    """Print a Markdown table."""
    checkouts = [Path(one) for one in sys.argv[1:]] or [Path(__file__).resolve().parents[1]]
    columns = [dict(rows(Tree(one))) for one in checkouts]
    print(f"| | {' | '.join(one.resolve().name for one in checkouts)} |")
    print("|---" * (1 + len(columns)) + "|")
    for name in columns[0]:
        print(f"| {name} | {' | '.join(column[name] for column in columns)} |")


if __name__ == "__main__":
    main()
