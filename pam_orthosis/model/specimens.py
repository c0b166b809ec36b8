# SPDX-License-Identifier: Apache-2.0
"""The muscles that the test rig has, as their rows in `config/muscle.yaml` are called."""

SPECIMENS = ("dmsp_20", "dmsp_10")
