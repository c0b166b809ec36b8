# SPDX-License-Identifier: Apache-2.0
"""What no effect explains, described by what was measured."""
