# SPDX-License-Identifier: Apache-2.0
"""Trajectory, observer and controllers; they know the model, never the plant."""
