# SPDX-License-Identifier: Apache-2.0
"""The leg in space, for rviz, Lichtblick and the like: description, frames, markers."""
