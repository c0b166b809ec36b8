# SPDX-License-Identifier: Apache-2.0
"""Recordings as uniform arrays, from tables and bags."""
