# SPDX-License-Identifier: Apache-2.0
"""Recordings that come with the package: bags to copy, and a case of the gap workflow to unpack."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import filled, writing

BAGS = {
    "walk": "gait without a person, 7 s (scenario default)",
    "person": "gait with a passive person of 75 kg, 7 s (scenario person)",
}
CASES = {
    "friction": "a knee with more joint friction than the model has: two bags to fit, two to judge, and the"
    " answer in sealed/",
}
MEASURED = {
    "angle": "angle",
    "extensor_pressure": "pressure",
    "flexor_pressure": "pressure",
    "extensor_voltage": "voltage",
    "flexor_voltage": "voltage",
}  # signal -> kind, which has one resolution
STEP_KEY = "steps"


def example_folder() -> Path:
    """Return the folder of the shipped recordings (installed package, or source tree)."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "examples"
    return installed if installed.is_dir() else package.parent / "bags"


def write_example(name: str, folder: Path) -> list[Path]:
    """Write an example into a new folder, all or nothing; return its bags; OrthosisError if that fails."""
    if name not in {*BAGS, *CASES}:
        raise OrthosisError(f"no example {name!r}; there are: {', '.join([*BAGS, *CASES])}")
    with filled(folder) as part:
        bags = _copied(name, part) if name in BAGS else _unpacked(name, part)
    return [folder / bag.relative_to(part) for bag in bags]


def _copied(name: str, folder: Path) -> list[Path]:
    with writing(folder):
        for file in (example_folder() / name).iterdir():
            shutil.copyfile(file, folder / file.name)
    return [folder]


def _unpacked(name: str, folder: Path) -> list[Path]:
    import numpy as np  # takes its time to load

    with np.load(example_folder() / f"{name}.npz") as packed:
        about = json.loads(str(packed["about"]))
        runs = dict.fromkeys(key.split("/")[0] for key in packed.files if "/" in key)
        for run in runs:
            _write_run(folder / run, about, {signal: packed[f"{run}/{signal}"] for signal in MEASURED})
    with writing(folder):
        (folder / "sealed").mkdir()
        answer = json.dumps(about["answer"], indent=2) + "\n"
        (folder / "sealed" / "truth.json").write_text(answer, encoding="utf-8")
    return [folder / run for run in runs]


def _write_run(folder: Path, about: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    """Write a bag from the changes of its signals, in steps of their resolution, from sample to sample."""
    import numpy as np

    from pam_orthosis.bag.arrays import write_arrays
    from pam_orthosis.bag.record import run_metadata
    from pam_orthosis.model.parameters import load

    nominal = load(about["nominal"])
    signals = {name: np.cumsum(changes[name]) * about[STEP_KEY][kind] for name, kind in MEASURED.items()}
    period_ns = round(nominal.scenario.control_period * 1e9)
    stamps = np.arange(len(signals["angle"]), dtype=np.int64) * period_ns
    write_arrays(folder, stamps, signals, run_metadata(nominal.nominal(), "friction"))
