# SPDX-License-Identifier: Apache-2.0
"""Emulation of a knee orthosis driven by two antagonistic fluidic muscles, as a ROS 2 node graph."""

__version__ = "0.1.0"
