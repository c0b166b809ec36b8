#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Run the identification procedure of the paper's section 2 on the emulated test rig and put what it
# finds into config/muscle.yaml: sh benchmarks/identify_muscles.sh [MUSCLE...] (dmsp_20 dmsp_10)
# Afterwards set plant.deviation.muscle_damping (config/plant.yaml) to plant.rig.dmsp_20.damping divided
# by the new muscle.dmsp_20.force.damping: the hardware does not change because it is known better.
set -eu
runs=$(mktemp -d)
trap 'rm -rf "$runs"' EXIT
for muscle in ${*:-dmsp_20 dmsp_10}; do
    pam-orthosis rig --muscle "$muscle" --out "$runs/$muscle"
    pam-orthosis identify "$runs/$muscle" --update config/muscle.yaml
done
