# SPDX-License-Identifier: Apache-2.0
"""Fits of a model to recordings, and what they leave."""
