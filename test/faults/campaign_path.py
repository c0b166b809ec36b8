# SPDX-License-Identifier: Apache-2.0
"""Importing this module makes the campaigns of `benchmarks` importable."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
