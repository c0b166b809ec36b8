# SPDX-License-Identifier: Apache-2.0
"""The page of scenarios, from `config/scenario.yaml`."""

from generators.markdown import WIDE, table
from pam_orthosis.model.parameters import experiments, scenario_names, scenario_overrides

HEAD = """# Scenarios

A scenario is a named set of parameters: the motion, the person, the disturbance. `pam-orthosis run
--scenario NAME` runs one, `pam-orthosis run --list` prints them. [Parameters](parameters/scenario.md) lists
what else can be set.

"""


def pages() -> dict[str, str]:
    """Return the page."""
    rows = [(f"`{name}`", meaning, _set(name)) for name, meaning in scenario_names().items()]
    return {"reference/scenarios.md": WIDE + HEAD + table(("scenario", "meaning", "sets"), rows)}


def experiment_table() -> str:
    """Return the diagnostic experiments: how they are done on an apparatus, and what they separate."""
    meaning = scenario_names()
    rows = ((words, meaning[name].rpartition(": ")[2], f"`{name}`") for name, words in experiments().items())
    return table(("on the apparatus", "separates", "scenario"), rows)


def _set(name: str) -> str:
    return "<br>".join(f"`{key}` = {value}" for key, value in scenario_overrides(name).items()) or "-"
