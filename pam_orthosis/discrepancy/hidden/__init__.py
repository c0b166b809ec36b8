# SPDX-License-Identifier: Apache-2.0
"""Blind test recordings from a second, independent plant. The gap workflow must not import this."""

from pam_orthosis.discrepancy.hidden.case import Case, make_case

__all__ = ["Case", "make_case"]
