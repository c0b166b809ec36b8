# SPDX-License-Identifier: Apache-2.0
"""Many bags or parameter sets, one after the other or on many cores and machines."""
