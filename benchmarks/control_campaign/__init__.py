# SPDX-License-Identifier: Apache-2.0
"""Controllers compared: hardware, cases, the classical baseline, what each controller knows."""
