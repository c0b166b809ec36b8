# SPDX-License-Identifier: Apache-2.0
"""The passive elastic moments of a person's knee and ankle, N m.

Riener and Edrich 1999, J. Biomech. 32:539-544. Angles in degrees: knee and hip flexion, ankle plantarflexion.
"""

import casadi as ca

from pam_orthosis.model.signals import Expression


def knee_moment(knee: Expression, hip: Expression) -> Expression:
    """Return the moment of a knee in the direction of flexion, with the ankle at 0, N m."""
    flexing = ca.exp(1.800 - 0.0352 * knee + 0.0217 * hip) + ca.exp(2.220 - 0.150 * knee)
    extending = ca.exp(-3.971 + 0.0495 * knee - 0.0128 * hip) + 4.820
    return flexing - extending


def ankle_moment(ankle: Expression, knee: Expression) -> Expression:
    """Return the moment of an ankle in the direction of plantarflexion, N m: a stretched calf has most."""
    stretched_calf = ca.exp(2.1016 - 0.0843 * ankle - 0.0176 * knee)
    return stretched_calf - ca.exp(-7.9763 + 0.1949 * ankle + 0.0008 * knee) - 1.792
