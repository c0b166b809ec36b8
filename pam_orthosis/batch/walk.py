# SPDX-License-Identifier: Apache-2.0
"""Walk once without ROS, with the same cores as the nodes; write a bag and print its verdict as JSON.

python -m pam_orthosis.batch.walk '{"scenario.seed": 2, "leg.person.mass": 80.0}' BOUND_DEG --out DIR
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from pam_orthosis.bag.simulated import record_run
from pam_orthosis.bag.verdict import Bound, judge
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load


def main(arguments: Sequence[str]) -> int:
    """Walk, judge, print; return 0 if the bound holds, 1 if not, 2 if these parameters cannot walk."""
    overrides, bound_deg, _, folder = arguments
    bag = Path(folder, "bag")
    try:
        record_run(load(json.loads(overrides)), "study", bag)
        verdict = judge(bag, Bound(float(bound_deg)))
    except OrthosisError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print(json.dumps(verdict.as_dict()))
    return 0 if verdict.passed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
