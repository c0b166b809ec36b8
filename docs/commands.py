# SPDX-License-Identifier: Apache-2.0
"""Run the commands that the documentation shows, each once; exit 1 if one failed.

    python docs/commands.py [--program FILE] [--list] [--keep]

Each tutorial runs to the letter in an empty folder of its own, all other pages share a further one. Exit
status 1 of a command is an answer, 2 and 3 are failures. The last line that a tutorial shows of an output
must be its last; `--keep` replaces what is shown, and the pictures of pages.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
SHOWN = DOCS / "shown"
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.M | re.S)
_SHOWN = re.compile(r'--8<-- "([\w.]+)"')
_FILE = re.compile(r"# ([a-z]+\.yaml)\b")  # the first line of a file that the reader writes
# what a reader has to fill in
_PLACEHOLDER = re.compile(r"\b[A-Z]{2,}\b(?!=)|/\*")
# these need another terminal, a ROS installation, hardware, a checkout, hours, or change the environment
ELSEWHERE = (
    r"(ros2|make|pip|colcon|pkill|\.) ", r"python (benchmarks|docs)/", r".*--no-plant", r".*--duration 3600",
    r".* examples/",
)  # fmt: skip
SHORT = (
    r"pam-orthosis (check|report|example|--help)",
    r"pam-orthosis run (--list|(--composed )?(--scenario \w+ )?--duration \d+ )",
    r"(cat|echo) ",
)


class Command(NamedTuple):
    """A command of a page, what it shows of the output (a file of `SHOWN`), and a file that it asks for."""

    page: str
    line: str
    shown: str = ""
    file: tuple[str, str] = ("", "")

    @property
    def kind(self) -> str:
        """Return `short`, `long` or `elsewhere`."""
        if _PLACEHOLDER.search(self.line) or _is(ELSEWHERE, self.line):
            return "elsewhere"
        return "short" if _is(SHORT, self.line) else "long"


def pages() -> list[Path]:
    """Return README and the pages that are written by hand, tutorials first."""
    found = sorted(DOCS.rglob("*.md"), key=lambda path: (path.parent.name != "tutorials", path))
    return [*found, ROOT / "README.md"]


def commands(page: Path) -> list[Command]:
    """Return the commands of a page in their order."""
    found: list[Command] = []
    file = ("", "")
    for language, text in _FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "sh":
            name = str(page.relative_to(ROOT))
            lines = [" ".join(line.split()) for line in text.splitlines() if line.strip()]
            found += [Command(name, line, file=file) for line in lines]
            file = ("", "")
        elif named := _FILE.match(text):
            file = (named[1], text)
        elif language == "console" and (shown := _SHOWN.search(text)):
            found[-1] = found[-1]._replace(shown=shown[1])
    return found


def all_commands() -> list[Command]:
    """Return the commands of all pages, each once."""
    seen: dict[str, Command] = {}
    for page in pages():
        for command in commands(page):
            seen.setdefault(command.line, command)
    return list(seen.values())


def places() -> Iterator[tuple[str, list[Command]]]:
    """Yield what runs in one folder: each tutorial, then all that the other pages show beside it."""
    rest: dict[str, Command] = {}
    done: set[str] = set()
    for page in pages():
        if page.parent.name == "tutorials":
            yield str(page.relative_to(ROOT)), commands(page)
            done |= {command.line for command in commands(page) if not command.line.startswith(OPENING)}
        else:
            rest |= {command.line: command for command in commands(page) if command.line not in rest}
    yield "other pages", [command for line, command in rest.items() if line not in done]


OPENING = ("pam-orthosis example", "pam-orthosis run --composed --scenario person")  # other pages need these


def run(line: str, folder: Path, program: Path) -> subprocess.CompletedProcess[str]:
    """Run a command line in a folder, `pam-orthosis` being the given program."""
    path = f'export PATH="{program.parent}:$PATH"; {line}'
    return subprocess.run(["sh", "-c", path], cwd=folder, capture_output=True, text=True, check=False)


def as_shown(output: str) -> str:
    """Return an output as a page shows it."""
    return output.rstrip() + "\n"


def _is(patterns, line: str) -> bool:
    return any(re.match(pattern, line) for pattern in patterns)


def _carry_out(command: Command, folder: Path, program: Path, keep: bool) -> bool:
    """Run a command and report it; return whether it failed."""
    if command.kind == "elsewhere":
        print(f"  elsewhere          {command.line}")
        return False
    if command.file[0]:
        (folder / command.file[0]).write_text(command.file[1], encoding="utf-8")
    start = time.monotonic()
    done = run(command.line, folder, program)
    print(f"  {time.monotonic() - start:6.1f} s  exit {done.returncode}  {command.line}", flush=True)
    if done.returncode > 1:
        print(done.stderr)
        return True
    if not command.shown:
        return False
    if keep:
        SHOWN.mkdir(exist_ok=True)
        (SHOWN / command.shown).write_text(as_shown(done.stdout), encoding="utf-8")
    last = (SHOWN / command.shown).read_text(encoding="utf-8").splitlines()[-1]
    if done.stdout.rstrip().splitlines()[-1:] != [last]:
        print(f"         its output does not end with {last!r}, as docs/shown/{command.shown} does")
        return True
    return False


def main() -> int:
    """Run what can run here; return 1 if a command failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--program", type=Path, default=Path(sys.executable).with_name("pam-orthosis"))
    parser.add_argument("--list", action="store_true", help="print the commands and their kind")
    parser.add_argument("--keep", action="store_true", help="replace shown outputs and pictures")
    parser.add_argument("--only", default="", metavar="PAGE", help="part of the name of the place to run")
    arguments = parser.parse_args()
    failed = 0
    for place, listed in places():
        if arguments.only not in place:
            continue
        print(place)
        with tempfile.TemporaryDirectory() as folder:
            for command in listed:
                if arguments.list:
                    print(f"  {command.kind:10s} {command.line}")
                else:
                    failed += _carry_out(command, Path(folder), arguments.program.absolute(), arguments.keep)
            if arguments.keep and not arguments.list:
                import pictures

                pictures.keep(Path(folder))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
