# SPDX-License-Identifier: Apache-2.0
"""Whether the muscles of a machine can be as long as its transmissions say."""

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters

STRETCHED, SHORTENED = -0.25, 0.6  # of its nominal length: no muscle gets there
PLACES = 21  # of the range of motion that are looked at


def check_lengths(machine: Machine, parameters: Parameters) -> None:
    """Raise OrthosisError if a muscle is out of reach wherever the machine is."""
    mechanism = machine.mechanism(parameters)
    low, high = mechanism.limits
    contractions = np.array(
        [[float(one) for one in mechanism.contractions(q)] for q in np.linspace(low, high, PLACES)]
    )
    for one, own in zip(machine.actuators, contractions.T, strict=True):
        if one.kind != "muscle":
            continue
        length = parameters.at(one.parameters).length
        if own.min() > SHORTENED * length or own.max() < STRETCHED * length:
            raise OrthosisError(
                f"actuator {one.name}: its transmission shortens it by {own.min():.3g} to {own.max():.3g} m"
                f" in its range of motion, but the muscle is {length:g} m long ({one.parameters}.length)"
            )
