# SPDX-License-Identifier: Apache-2.0
"""Pages of the notebooks, with the outputs that they hold."""

import json
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"


def pages() -> dict[str, str]:
    """Return a page for each notebook."""
    return {f"notebooks/{file.stem}.md": _page(file) for file in sorted(FOLDER.glob("*.ipynb"))}


def _page(file: Path) -> str:
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join(part for cell in cells for part in _cell(cell))


def _cell(cell: dict) -> list[str]:
    text = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return [text]
    return [f"```python\n{text}\n```", *map(_output, cell["outputs"])]


def _output(output: dict) -> str:
    """Return what a cell shows: a picture, a table, or text."""
    if output["output_type"] == "stream":
        return f"```text\n{''.join(output['text']).rstrip()}\n```"
    data = output["data"]
    if "image/png" in data:
        return f'<img alt="output of the cell above" src="data:image/png;base64,{data["image/png"].strip()}">'
    return (
        "".join(data["text/html"]) if "text/html" in data else f"```text\n{''.join(data['text/plain'])}\n```"
    )
