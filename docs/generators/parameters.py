# SPDX-License-Identifier: Apache-2.0
"""A page for each file of `config/`: every parameter with unit, range, meaning and source."""

from pathlib import Path

from generators.markdown import WIDE, parameter_rows
from pam_orthosis.model.device import device_named
from pam_orthosis.model.parameters import SUBJECTS, load

FOLDER = "reference/parameters"
ABOUT = {
    "muscle": "Fluidic muscles in the nominal model of the controllers: Eqs. (14), (16), (17).",
    "valve": "Air, supply, valves and hoses in the nominal model of the controllers.",
    "leg": "Orthosis and person in the nominal model of the controllers.",
    "control": "Observer, controllers and guards.",
    "rig": "The muscle test rig and its procedure.",
    "plant": "The emulated hardware: how it deviates from the nominal model, and its sensors.",
    "scenario": "What a run does.",
    "gap": "The gap workflow: tolerances, thresholds, catalogue.",
    "ankle": "What the ankle and the joints of a leg have beside the rows of the other files.",
}


def pages() -> dict[str, str]:
    """Return the pages."""
    made = {f"{FOLDER}/{subject}.md": _page(subject) for subject in SUBJECTS} | {
        f"{FOLDER}/ankle.md": _ankle()
    }
    lines = [f"- [`{subject}`]({subject}.md): {about}" for subject, about in ABOUT.items()]
    head = (
        "# Parameters\n\nEach file of `config/` has a page here: every parameter with its shipped value,"
        " unit, range, meaning and source. `--param KEY=VALUE` sets one for a run, `--model FILE` sets"
        " many.\n\n"
    )
    return {f"{FOLDER}/index.md": head + "\n".join(lines) + "\n", **made}


def _page(subject: str) -> str:
    rows = [
        r for r in load().rows() if r.key.split(".")[0] == subject and not r.key.startswith("plant.effects.")
    ]
    page = f"{WIDE}# Parameters: {subject}\n\n{ABOUT[subject]}\n\n{parameter_rows(rows)}"
    if subject == "plant":
        page += "\nThe [catalogue of effects](../effects/index.md) lists `plant.effects.*`.\n"
    if subject == "scenario":
        page += "\nNamed sets of these parameters: [scenarios](../scenarios.md).\n"
    return page


def _ankle() -> str:
    shared = {row.key for row in load().rows()}
    leg = device_named(Path("leg"))
    own = [row for row in load({}, leg.joints["ankle"]).rows() if row.key not in shared]
    rows = [row for row in own if not row.key.startswith(("plant.effects.", "plant.person.", "effects."))]
    return f"{WIDE}# Parameters: ankle\n\n{ABOUT['ankle']}\n\n{parameter_rows(rows)}"
