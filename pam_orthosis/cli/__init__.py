# SPDX-License-Identifier: Apache-2.0
"""Command line: one verb a file, no mathematics."""
