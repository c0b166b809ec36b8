# SPDX-License-Identifier: Apache-2.0
"""Print the versions of the running environment as pip constraints: `make constraints`."""

import sys
from importlib.metadata import distributions

OWN = {"pam-orthosis", "pip", "setuptools"}
HEAD = """\
# Versions with which the tests passed, on the Python version that each line names; another Python takes what
# setup.py allows. Made by `make constraints`.
"""


def main() -> None:
    """Print a line for each package that pip installed."""
    python = ".".join(map(str, sys.version_info[:2]))
    found = {
        one.metadata["Name"].lower().replace("_", "-"): one.version
        for one in distributions()
        if (one.read_text("INSTALLER") or "").strip() == "pip"
    }
    lines = [f"{name}=={version}; python_version == '{python}'" for name, version in sorted(found.items())]
    print(HEAD + "\n".join(line for line in lines if line.split("==")[0] not in OWN))


if __name__ == "__main__":
    main()
