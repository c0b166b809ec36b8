# SPDX-License-Identifier: Apache-2.0
"""Campaigns that treat the package badly, and what they count: `benchmarks/faults.py`."""
