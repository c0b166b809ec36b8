# SPDX-License-Identifier: Apache-2.0
"""Recording, reading and judging MCAP bags."""
