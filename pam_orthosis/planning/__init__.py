# SPDX-License-Identifier: Apache-2.0
"""Motions that are within the reach of the muscles, by the controllers' own model."""

RESERVE = 3.0e3  # Pa: with less the feedback has nothing left, with more the plan gives way too much
