# SPDX-License-Identifier: Apache-2.0
"""The paper's results, computed again: one module a figure, and the table that sets them side by side."""
