# SPDX-License-Identifier: Apache-2.0
"""The campaigns of `benchmarks` for tests: a small fixed share of each."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
