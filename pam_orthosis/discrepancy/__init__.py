# SPDX-License-Identifier: Apache-2.0
"""The gap workflow: find, name, add and show a missing physical effect."""
