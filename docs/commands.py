# SPDX-License-Identifier: Apache-2.0
"""Run the commands that the documentation shows; with `--list` only tell them.

A command is a line of four spaces and a known first word. The long ones run for minutes and more; those of
`ELSEWHERE` need what a script has not: another terminal, the ROS command line, a person who reads.
"""

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SHOWN = ("README.md", "docs/*.md")
_COMMAND = re.compile(r"^ {4}((?:pam-orthosis|python|sh|make|ros2|pip|colcon)\s[^#\n]*)", flags=re.M)
# what a reader has to fill in
_PLACEHOLDER = re.compile(r"\b[A-Z]{2,}\b(?!=)|\.\.\.|\.csv\b")
CHEAP = (
    r"pam-orthosis (check|report|--help)",
    r"pam-orthosis run --composed --duration [1-5] ",
)
ELSEWHERE = (
    r"ros2 ", r"make ", r"pip ", r"colcon ", r".*--realtime", r".*--no-plant", r"sh docs/studies",
    r"python (benchmarks|docs/generate|docs/studies/(gains|identified))",
)  # fmt: skip


class Command(NamedTuple):
    """A command of a page."""

    page: str
    line: str

    @property
    def kind(self) -> str:
        """Return `cheap`, `long` or `elsewhere`."""
        if _PLACEHOLDER.search(self.line) or _is(ELSEWHERE, self.line):
            return "elsewhere"
        return "cheap" if _is(CHEAP, self.line) else "long"


def commands() -> list[Command]:
    """Return all commands, page by page in the order in which they are shown."""
    pages = [path for pattern in SHOWN for path in sorted(ROOT.glob(pattern))]
    return [
        Command(str(page.relative_to(ROOT)), " ".join(line.split()))
        for page in pages
        for line in _COMMAND.findall(page.read_text(encoding="utf-8"))
    ]


def workplace(folder: Path) -> None:
    """Fill a folder with what commands of the documentation expect beside them."""
    for name in ("bags", "config", "docs"):
        shutil.copytree(ROOT / name, folder / name)


def run(command: Command, folder: Path) -> subprocess.CompletedProcess:
    """Run a command in a folder; programs are those of the running Python."""
    first, *rest = shlex.split(command.line)
    program = {
        "pam-orthosis": [sys.executable, "-m", "pam_orthosis.cli.main"],
        "python": [sys.executable],
    }.get(first, [first])
    return subprocess.run([*program, *rest], cwd=folder, capture_output=True, text=True, check=False)


def _is(patterns, line: str) -> bool:
    return any(re.match(pattern, line) for pattern in patterns)


def main() -> int:
    """Run what can run here, page by page; return 1 if a command failed."""
    failed, pages = 0, {}
    for command in commands():
        pages.setdefault(command.page, []).append(command)
    for page, shown in pages.items():
        print(page)
        with tempfile.TemporaryDirectory() as folder:
            workplace(Path(folder))
            for command in shown:
                failed += _told(command, Path(folder))
    return int(failed > 0)


def _told(command: Command, folder: Path) -> bool:
    """Run and tell; return whether it failed. Exit status 1 is an answer, not a failure."""
    if "--list" in sys.argv or command.kind == "elsewhere":
        print(f"  {command.kind:10s} {command.line}")
        return False
    start = time.monotonic()
    done = run(command, folder)
    print(f"  {time.monotonic() - start:6.1f} s  exit {done.returncode}  {command.line}", flush=True)
    if done.returncode > 1:
        print(done.stderr)
    return done.returncode > 1


if __name__ == "__main__":
    sys.exit(main())
