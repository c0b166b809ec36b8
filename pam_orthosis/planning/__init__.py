# SPDX-License-Identifier: Apache-2.0
"""Motions that are within the reach of the muscles, by the controllers' own model."""
