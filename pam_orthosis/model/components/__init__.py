# SPDX-License-Identifier: Apache-2.0
"""What machines are built of: chambers, valves and actuators; each equation once."""
