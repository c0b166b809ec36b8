# SPDX-License-Identifier: Apache-2.0
"""Blind test recordings of a second, independently written plant. The gap workflow must not import this."""
