# SPDX-License-Identifier: Apache-2.0
"""Muscle identification on the test rig, eqs. (18)-(23)."""
