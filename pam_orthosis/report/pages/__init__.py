# SPDX-License-Identifier: Apache-2.0
"""Pages of commands that work without a bag, in the design of `report.page`."""
