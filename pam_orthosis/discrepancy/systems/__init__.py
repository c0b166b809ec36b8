# SPDX-License-Identifier: Apache-2.0
"""What a search needs to know of a system, and the systems there are."""
