# SPDX-License-Identifier: Apache-2.0
"""Which shape a machine has, by its mechanism."""

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.scene.leg import leg
from pam_orthosis.scene.one_axis import one_axis
from pam_orthosis.scene.shape import Shape

SHAPES = {"knee": leg, "ankle": one_axis, "rotation": one_axis, "sole": one_axis, "translation": one_axis}


def shape_of(parameters: Parameters) -> Shape:
    """Return the shape of the machine that the parameters describe; OrthosisError if it has none."""
    machine = parameters.declared
    if machine.kind not in SHAPES:
        raise OrthosisError(f"a {machine.kind} has no picture: {', '.join(SHAPES)} have one")
    return SHAPES[machine.kind](parameters)
