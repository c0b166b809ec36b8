# SPDX-License-Identifier: Apache-2.0
"""Campaigns of faults; each adds what it counted to a file of results, `table` makes docs/faults.md's tables.

python benchmarks/faults.py input --count 600 --seed 1 [--out faults.json]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

WALK = Path(__file__).resolve().parents[1] / "bags" / "walk"


def run_input(arguments: argparse.Namespace, work: Path) -> dict:
    """Mutated bags, YAML, tables, options, folders."""
    from fault_campaign import inputs

    results = inputs.campaign(work, WALK, arguments.count, arguments.seed)
    return {"count": len(results), "seed": arguments.seed, "kinds": inputs.summary(results)}


CAMPAIGNS = {"input": run_input}


def main() -> int:
    """Run a campaign; return 0 if it found nothing wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("campaign", choices=CAMPAIGNS)
    parser.add_argument("--count", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=Path, help="keep the inputs that were wrong here")
    parser.add_argument("--out", type=Path, default=Path("faults.json"), help="file of results")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-faults-") as folder:
        work = arguments.work or Path(folder)
        (work / "base").mkdir(parents=True)
        told = CAMPAIGNS[arguments.campaign](arguments, work)
    results = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    arguments.out.write_text(json.dumps(results | {arguments.campaign: told}, indent=2) + "\n")
    print(json.dumps(told, indent=2))
    wrong = sum(
        kind[name] for kind in told["kinds"].values() for name in ("tracebacks", "hangs", "other_faults")
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
