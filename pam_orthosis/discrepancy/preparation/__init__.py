# SPDX-License-Identifier: Apache-2.0
"""What comes before a search: recordings are checked, the model is recalibrated."""
