# SPDX-License-Identifier: Apache-2.0
"""Verdict, words, contract and model file of what was found."""
