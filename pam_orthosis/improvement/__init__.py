# SPDX-License-Identifier: Apache-2.0
"""Improve a machine: what the gap workflow learns from its recordings goes into the controllers' model."""
