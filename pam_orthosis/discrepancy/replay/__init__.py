# SPDX-License-Identifier: Apache-2.0
"""Replay of recordings by a model, as machine code, and whitened residuals."""
