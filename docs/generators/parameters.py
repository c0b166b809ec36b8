# SPDX-License-Identifier: Apache-2.0
"""A page for each file of `config/`: every parameter with unit, range, meaning and source."""

from generators.markdown import NOTE, parameter_rows, table
from pam_orthosis.model.parameters import SUBJECTS, config_folder, load, read_yaml, scenario_names

ABOUT = {
    "muscle": "Fluidic muscles as the controllers believe them: Eqs. (14), (16), (17).",
    "valve": "Air, supply, valves and hoses as the controllers believe them.",
    "leg": "Orthosis and person as the controllers believe them.",
    "control": "Observer and controllers.",
    "rig": "The test rig and its procedure.",
    "plant": "The truth: how the emulated hardware deviates from the controllers' belief, and its sensors.",
    "scenario": "What a run does.",
    "gap": "The gap workflow.",
}


def pages() -> dict[str, str]:
    """Return the pages."""
    made = {f"parameters/{subject}.md": _page(subject) for subject in SUBJECTS}
    lines = [f"- [{subject}]({subject}.md): {ABOUT[subject]}" for subject in SUBJECTS]
    index = "# Parameters\n\nOne page for each file of `config/`. Set one by `--param KEY=VALUE`.\n\n"
    return {"parameters/index.md": NOTE + index + "\n".join(lines) + "\n", **made}


def _page(subject: str) -> str:
    rows = [
        r for r in load().rows() if r.key.split(".")[0] == subject and not r.key.startswith("plant.effects.")
    ]
    page = f"{NOTE}# Parameters: {subject}\n\n{ABOUT[subject]}\n\n{parameter_rows(rows)}"
    if subject == "plant":
        page += "\n`plant.effects.*`: the [catalogue of effects](../effects/index.md).\n"
    if subject == "scenario":
        page += f"\n## Scenarios\n\n{_scenarios()}"
    return page


def _scenarios() -> str:
    changes = read_yaml(config_folder() / "scenario.yaml")["scenarios"]
    rows = [
        (
            f"`{name}`", meaning,
            ", ".join(f"`{k}` = {v}" for k, v in (changes[name].get("set") or {}).items()) or "-",
        )
        for name, meaning in scenario_names().items()
    ]  # fmt: skip
    return table(("scenario", "what it shows", "sets"), rows)
