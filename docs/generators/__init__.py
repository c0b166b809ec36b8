# SPDX-License-Identifier: Apache-2.0
"""Makers of the generated documentation; each has `pages() -> {path below docs/: Markdown}`."""
