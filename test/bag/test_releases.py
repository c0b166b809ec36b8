# SPDX-License-Identifier: Apache-2.0
"""The verdict tells when a machine was let go, why by the nodes' reports, and whether it came back."""

import json

import numpy as np
import pytest

from bags import PERIOD_NS, TABLE, joint_state, reference, write
from pam_orthosis.bag import messages
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import DIAGNOSTICS, resolve
from pam_orthosis.cli.main import main

SECONDS, LOWEST, USUAL = 6.0, 1.2e5, 3e5
TIME = np.arange(round(SECONDS / 0.005)) * 0.005
KNOWN = {"control.position.minimum_pressure": LOWEST, "scenario.duration": SECONDS}
OK, WARN, ERROR = 0, 1, 2


def report(node, level, message="", **values):
    """Return a report of a node as it is in a bag."""
    told = [messages.new("diagnostic_msgs/msg/KeyValue", key=key, value=text) for key, text in values.items()]
    return messages.new(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level, name=f"{node}: loop", message=message, hardware_id="", values=told,
    )  # fmt: skip


def between(since, until):
    return (since <= TIME) & (until > TIME)


def check(folder, capsys, vents, away, reports=(), lowest=None, lost=None, hole=None, **known):
    """Write a bag: where valves vent, the error (deg), reports (s, status); return what `check` says.

    Commands are missing where they are `lost`, everything where there is a `hole`.
    """
    kinds = ("joint_states", "reference", "extensor/valve_command", "flexor/valve_command")
    asked = ("extensor/pressure_reference", "flexor/pressure_reference")
    with BagWriter(folder, {"parameters": json.dumps({**KNOWN, **known})}) as writer:
        for topic in (*kinds, *asked, DIAGNOSTICS):
            writer.add_topic(resolve(topic), TABLE.by_name[topic].type)
        for k in np.flatnonzero(~hole) if hole is not None else range(len(TIME)):
            stamp_ns = int(k) * PERIOD_NS
            write(writer, "joint_states", stamp_ns, joint_state(stamp_ns, "knee", [-np.radians(away[k])]))
            write(writer, "reference", stamp_ns, reference(stamp_ns, (0.0, 0.0)))
            for topic in kinds[2:] if lost is None or not lost[k] else ():
                valve = topic.split("/")[0] + "_valve"
                write(writer, topic, stamp_ns, joint_state(stamp_ns, valve, [-1.0 if vents[k] else 0.1]))
            pressure = LOWEST if lowest is not None and lowest[k] else USUAL
            for topic in asked:
                write(writer, topic, stamp_ns, messages.fluid_pressure(stamp_ns, "extensor", pressure))
            for at, status in reports:
                if at == TIME[k]:
                    array = messages.new(
                        "diagnostic_msgs/msg/DiagnosticArray",
                        header=messages.header(stamp_ns), status=[status],
                    )  # fmt: skip
                    write(writer, DIAGNOSTICS, stamp_ns, array)
    assert main(["check", str(folder), "--bound-deg", "3", "--partial"]) in (0, 1)
    text = [line for line in capsys.readouterr().out.splitlines() if line.startswith("released")]
    main(["check", str(folder), "--json"])
    return [line.removeprefix("released").strip() for line in text], json.loads(capsys.readouterr().out)


def test_a_joint_that_a_guard_let_go_is_told_with_reason_and_return(tmp_path, capsys):
    """It is asked for the lowest pressure between two vents; its reference passes it before it is back."""
    vents, lowest = between(1.8, 2.5) | between(2.7, 3.0), between(2.5, 2.7) | between(3.0, 3.2)
    away = np.where(between(1.5, 3.9) & ~between(3.5, 3.7), 20.0, 0.1)
    reports = [
        (1.0, report("position_controller", OK, "ok", vent="")),
        (2.0, report("position_controller", WARN, "vent", vent="knee does not follow")),
        (3.0, report("position_controller", ERROR, "given up")),
    ]
    told, found = check(tmp_path / "walk", capsys, vents, away, reports, lowest)
    assert told == ["at 1.800 s, for 1.400 s: knee does not follow; back at 3.900 s"]
    reason = {"reason": "knee does not follow"}
    assert found["releases"] == [{"since_s": 1.8, "until_s": 3.2, "back_s": 3.9, **reason}]
    assert not found["passed"]


def test_without_a_release_nothing_is_told(tmp_path, capsys):
    """A valve that vents for a moment is controlled, and reports of other things are no reason."""
    reports = [(2.0, report("position_controller", WARN, "held_samples", vent=""))]
    told, found = check(tmp_path / "walk", capsys, between(2.0, 2.05), 0.0 * TIME, reports)
    assert told == []
    assert found["releases"] == []
    assert found["passed"]


@pytest.mark.parametrize(
    ("reports", "reason"),
    [
        ([(3.0, report("position_controller", OK, released="pressure does not follow"))],
         "pressure does not follow"),
        ([(2.0, report("position_controller", WARN, vent="pressure does not follow")),
          (2.0, report("inverse_valve_model", ERROR, "emergency stop"))], "emergency stop"),
        ([(2.0, report("left/position_controller", WARN, vent="of another leg"))], "no report tells why"),
        ([(1.0, report("position_controller", WARN, vent="long before")),
          (4.0, report("position_controller", WARN, vent="long after"))], "no report tells why"),
    ],
)  # fmt: skip
def test_the_reason_is_that_of_the_first_report_on_it(tmp_path, capsys, reports, reason):
    told, _ = check(tmp_path / "walk", capsys, between(1.8, 2.5), 0.0 * TIME, reports)
    assert told == [f"at 1.800 s, for 0.700 s: {reason}; back at 2.500 s"]


@pytest.mark.parametrize(
    ("duration", "reason"), [(SECONDS, "no report tells why"), (60.0, "the run was cut short")]
)
def test_a_joint_that_does_not_come_back(tmp_path, capsys, duration, reason):
    vents, away = between(1.0, 2.0) | between(5.0, 7.0), np.where(TIME > 1.0, 9.0, 0.0)
    told, found = check(tmp_path / "walk", capsys, vents, away, **{"scenario.duration": duration})
    assert told == [
        "at 1.000 s, for 1.000 s: no report tells why; not back",
        f"at 5.000 s, until the end: {reason}",
    ]
    assert [(one["until_s"], one["back_s"]) for one in found["releases"]] == [(2.0, None), (None, None)]


def test_a_run_that_ends_released_is_not_passed_however_small_its_error(tmp_path, capsys):
    reports = [(5.0, report("inverse_valve_model", ERROR, "emergency stop"))]
    told, found = check(tmp_path / "walk", capsys, between(5.0, 7.0), 0.0 * TIME, reports)
    assert told == ["at 5.000 s, until the end: emergency stop"]
    assert (found["passed"], found["max_abs_error_deg"]) == (False, 0.0)
    assert main(["check", str(tmp_path / "walk")]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("FAILED: ended released, maximum 0.000 deg")
    _, back = check(tmp_path / "back", capsys, between(4.0, 5.0), 0.0 * TIME, reports)
    assert back["passed"]


def test_valves_that_get_no_commands_vent(tmp_path, capsys):
    nothing, lost = np.zeros_like(TIME, dtype=bool), between(2.0, 4.0)
    told, _ = check(tmp_path / "walk", capsys, nothing, np.where(between(2.2, 4.5), 30.0, 0.0), lost=lost)
    assert told == ["at 2.095 s, for 1.905 s: no commands; back at 4.500 s"]


def test_answers_that_are_late_again_and_again_are_one_release(tmp_path, capsys):
    """Each silence is hardly longer than the watchdog of the valves waits, and the joint falls."""
    nothing = np.zeros_like(TIME, dtype=bool)
    lost = between(2.0, 2.16) | between(2.17, 2.32) | between(2.4, 2.56)
    told, _ = check(tmp_path / "walk", capsys, nothing, np.where(between(2.2, 4.0), 65.0, 0.0), lost=lost)
    assert told == ["at 2.095 s, for 0.465 s: no commands; back at 4.000 s"]


def test_hardware_that_took_no_samples_is_a_release_if_the_joint_was_led_back(tmp_path, capsys):
    nothing = np.zeros_like(TIME, dtype=bool)
    reports = [
        (at, report("position_controller", OK, "ok", returns=count)) for at, count in ((1.0, "0"), (3.0, "1"))
    ]
    away = np.where(between(2.3, 4.0), 65.0, 0.0)
    told, _ = check(tmp_path / "walk", capsys, nothing, away, reports, hole=between(2.0, 2.3))
    assert told == ["at 1.995 s, for 0.305 s: no samples, so no commands; back at 4.000 s"]


def test_a_hole_in_the_bag_is_no_release(tmp_path, capsys):
    nothing = np.zeros_like(TIME, dtype=bool)
    told, _ = check(tmp_path / "walk", capsys, nothing, 0.0 * TIME, hole=between(2.0, 4.0))
    assert told == []


def test_what_there_is_of_a_run_that_was_cut_short_may_end_released(tmp_path, capsys):
    known = {"scenario.duration": 60.0}
    told, _ = check(tmp_path / "walk", capsys, between(5.0, 7.0), 0.0 * TIME, **known)
    assert told == ["at 5.000 s, until the end: the run was cut short"]
    assert main(["check", str(tmp_path / "walk"), "--partial"]) == 0


def test_hardware_that_began_while_the_run_was_on_is_told(tmp_path, capsys):
    """Its first sample comes behind the last that it may have missed, or that was answered."""
    none, hole = between(0.0, 0.0), between(2.0, 2.25)
    reports = [(4.0, report("plant_simulator", WARN, "begun_anew", begun_anew="at 2.250 s"))]
    period = {"scenario.control_period": PERIOD_NS / 1e9}
    lost, anew = (
        "50 of 1200 samples are missing, the first at 2.000 s",
        "the hardware began anew, at rest, at 2.250 s",
    )
    _, found = check(tmp_path / "lost", capsys, none, 0.0 * TIME, reports, hole=hole, **period)
    assert found["incomplete"] == f"{lost}; {anew}"
    _, found = check(tmp_path / "astray", capsys, none, 20.0 * between(2.25, 3.0), reports, **period)
    assert found["incomplete"] == anew
    _, found = check(tmp_path / "other", capsys, none, 20.0 * between(2.25, 3.0), hole=hole, **period)
    assert found["incomplete"] == lost


def test_a_drivers_own_reason_is_before_what_a_guard_makes_of_it(tmp_path, capsys):
    failed = report("modbus_driver", ERROR, "fault: again there after a loss: timed out")
    failed.name = "modbus_driver"
    stopped = report("modbus_driver", ERROR, "ready", emergency_stop="True")
    stopped.name = "modbus_driver"
    guard = report("position_controller", WARN, "released", released="knee does not follow")
    reports = [(1.0, stopped), (3.5, guard), (4.0, failed)]
    told, _ = check(tmp_path / "walk", capsys, between(3.0, 4.0), 0.0 * TIME, reports)
    assert told == [
        "at 3.000 s, for 1.000 s: modbus_driver fault: again there after a loss: timed out; back at 4.000 s"
    ]
