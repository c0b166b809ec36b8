# SPDX-License-Identifier: Apache-2.0
"""Physics of muscles, gas, valves and leg; each equation once, as CasADi expressions."""
