# SPDX-License-Identifier: Apache-2.0
"""A machine in space, for rviz, Lichtblick and the like: description, frames, markers."""
