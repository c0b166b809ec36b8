# SPDX-License-Identifier: Apache-2.0
"""Persons in the orthosis, as the emulated hardware has them: controllers never read this."""
