# SPDX-License-Identifier: Apache-2.0
"""Open a recorded bag in Rerun: the moving leg, angle, pressures, valves.

    pip install rerun-sdk
    python config/rerun_layout.py bags/walk/walk_0.mcap

It starts the viewer; `--connect`, `--save FILE.rrd` and `--serve` are Rerun's own options.
"""

import argparse
from pathlib import Path

PLOTS = {
    "knee angle, rad: measured, estimated": ("/joint_states/position", "/estimate/position"),
    "pressures and their references, Pa (absolute)": (
        "/extensor/pressure", "/extensor/pressure_reference",
        "/flexor/pressure", "/flexor/pressure_reference",
    ),
    "valve commands, -1 vent to 1 fill": (
        "/extensor/valve_command/position", "/flexor/valve_command/position",
    ),
}  # fmt: skip
EYE, TARGET = (0.42, -1.4, 0.4), (0.42, 0.0, 0.1)  # m, in the leg's root frame


def main() -> None:
    """Parse the command line, send the layout and the file to a viewer."""
    import rerun
    import rerun.blueprint as layout

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bag", type=Path, help="an .mcap file")
    rerun.script_add_args(parser)
    arguments = parser.parse_args()
    if not arguments.bag.is_file():
        parser.error(f"{arguments.bag} is not an .mcap file: give the file inside the bag's folder")
    rerun.script_setup(arguments, "pam_orthosis")
    eye = layout.EyeControls3D(position=EYE, look_target=TARGET, eye_up=(0, 0, 1))
    leg = layout.Spatial3DView(origin="/", name="leg", eye_controls=eye)
    plots = [layout.TimeSeriesView(origin="/", contents=paths, name=name) for name, paths in PLOTS.items()]
    columns = layout.Horizontal(leg, layout.Vertical(*plots), column_shares=[3, 4])
    hidden = (layout.BlueprintPanel(state="hidden"), layout.SelectionPanel(state="hidden"))
    rerun.send_blueprint(layout.Blueprint(columns, *hidden, layout.TimePanel(state="collapsed")))
    rerun.log_file_from_path(arguments.bag)
    rerun.script_teardown(arguments)


if __name__ == "__main__":
    main()
