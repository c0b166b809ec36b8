# SPDX-License-Identifier: Apache-2.0
"""Write the generated pages and the blocks of README.md; `--check` only says which are out of date."""

import re
import sys
from pathlib import Path

from generators import effects, equations, faults, nodes, parameters

from pam_orthosis.bag.topics import RECORDER, TOPICS
from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.check import describe
from pam_orthosis.model.parameters import scenario_names

ROOT = Path(__file__).resolve().parent.parent
README, DOCS = ROOT / "README.md", ROOT / "docs"
FOLDERS = ("effects", "nodes", "parameters")  # generated altogether


def graph() -> str:
    """Return the node graph as a diagram and its topics as a table."""
    lines = ["```mermaid", "graph LR"]
    for topic in TOPICS:
        if topic.rate != "step":
            continue
        for producer in topic.producers:
            for consumer in topic.consumers:
                lines.append(f"  {producer} -- {topic.name} --> {consumer}")
    lines += ["```", "", "| topic | type | unit | from | to |", "|---|---|---|---|---|"]
    for topic in TOPICS:
        producers = "every node" if len(topic.producers) > 1 else topic.producers[0]
        listeners = [name for name in topic.subscribers if name != RECORDER]
        to = "every other node" if len(listeners) > 3 else ", ".join(listeners)
        to = ", ".join(filter(None, [to, "recorder" if topic.recorded else ""]))
        name = f"`{topic.name}`: {topic.meaning}"
        lines.append(f"| {name} | `{topic.type.replace('/msg/', '/')}` | {topic.unit} | {producers} | {to} |")
    return "\n".join(lines)


def verdict() -> str:
    """Return what `check` prints of the reference bag."""
    return f"```\n{describe(judge(ROOT / 'bags' / 'walk'))}\n```"


def results() -> str:
    """Return the tracking of the reference bags beside the paper's figures."""
    rows = ["| run | maximum error | RMS | steady state | voltage variation |", "|---|---|---|---|---|"]
    rows.append("| paper, real device without a person | about 3 deg | - | below 1 deg | - |")
    for name, meaning in (("walk", "default"), ("person", "person")):
        v = judge(ROOT / "bags" / name)
        variation = ", ".join(f"{value:.0f}" for value in v.voltage_variation_per_s.values())
        rows.append(
            f"| [bags/{name}](bags/{name}): {scenario_names()[meaning]} | {v.max_abs_error_deg:.2f} deg"
            f" | {v.rms_error_deg:.2f} deg | {v.steady_state_error_deg:.2f} deg | {variation} V/s |"
        )
    return "\n".join(rows)


BLOCKS = {"graph": graph, "verdict": verdict, "results": results}


def filled(text: str) -> str:
    """Return the text with each block between its two markers made anew."""
    for name, make in BLOCKS.items():
        pattern = rf"<!-- {name} -->.*?<!-- /{name} -->"
        block = f"<!-- {name} -->\n{make()}\n<!-- /{name} -->"
        text = re.sub(pattern, lambda _, block=block: block, text, flags=re.S)
    return text


def wanted() -> dict[Path, str]:
    """Return what each generated file should hold."""
    files = {README: filled(README.read_text(encoding="utf-8"))}
    for maker in (equations, effects, faults, nodes, parameters):
        files |= {DOCS / name: text for name, text in maker.pages().items()}
    return files


def main() -> int:
    """Write what is out of date, and remove generated pages that are no more; or only tell them."""
    files = wanted()
    stale = [path for path, text in files.items() if not path.exists() or path.read_text("utf-8") != text]
    extra = [path for folder in FOLDERS for path in (DOCS / folder).glob("*.md") if path not in files]
    for path in [*stale, *extra]:
        print(f"{path.relative_to(ROOT)} is out of date")
    if "--check" in sys.argv:
        return int(bool(stale or extra))
    for path in stale:
        path.parent.mkdir(exist_ok=True)
        path.write_text(files[path], encoding="utf-8")
    for path in extra:
        path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
