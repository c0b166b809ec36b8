# SPDX-License-Identifier: Apache-2.0
"""The live view's web server: who knows the address is answered, nobody else, from this host alone."""

import json
from http.client import HTTPConnection
from threading import Event, Thread
from types import SimpleNamespace

import pytest
from live_runs import LIMIT_S, wait_for
from own_domain import own_domain

from pam_orthosis.nodes.live_server import LiveServer

PRESSED = []


@pytest.fixture
def server():
    one = LiveServer("<p>page</p>", {"stop": lambda: PRESSED.append("stop") or "stopped"})
    PRESSED.clear()
    yield one
    one.close()


def asked(server, method, name, token=None, **headers):
    """Return status and text of an answer."""
    connection = HTTPConnection("127.0.0.1", server.port, timeout=LIMIT_S)
    path = f"/{server.token if token is None else token}/{name}"
    connection.request(method, path, headers={key.capitalize(): value for key, value in headers.items()})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_the_page_and_the_button_are_those_of_the_address(server):
    assert server.url == f"http://127.0.0.1:{server.port}/{server.token}/"
    assert asked(server, "GET", "") == (200, "<p>page</p>")
    own = f"http://127.0.0.1:{server.port}"
    assert asked(server, "POST", "stop", origin=own) == (200, "stopped")
    assert PRESSED == ["stop"]


@pytest.mark.parametrize(
    ("token", "headers"),
    [
        ("", {}),
        ("guessed", {}),
        (None, {"host": "evil.example"}),
        (None, {"host": "evil.example:80", "origin": "http://evil.example"}),
        (None, {"origin": "http://evil.example"}),
        (None, {"origin": "http://127.0.0.1:1"}),
        (None, {"origin": "null"}),
    ],
)
def test_who_comes_from_elsewhere_presses_nothing(server, token, headers):
    for method, name in (("POST", "stop"), ("GET", ""), ("GET", "events")):
        status, text = asked(server, method, name, token, **headers)
        assert status == 403
        assert "page" not in text
    assert PRESSED == []


def test_a_button_is_not_pressed_by_looking_at_it(server):
    assert asked(server, "GET", "stop")[0] == 404
    assert asked(server, "POST", "other")[0] == 404
    assert asked(server, "POST", "")[0] == 404
    assert PRESSED == []


def test_nothing_listens_outside_this_host(server):
    assert server._server.server_address[0] == "127.0.0.1"


def test_who_is_slow_hears_the_newest_and_all_hear_the_last(server):
    for number in range(100):
        server.say(number)
    heard, first = [], Event()

    def send(text):
        heard.append(json.loads(text.removeprefix("data: ")))
        first.set()

    reader = Thread(target=server.follow, args=[send])
    reader.start()
    assert first.wait(60)
    server.say("last", last=True)
    reader.join(60)
    assert heard == [99, "last"]


@pytest.fixture
def view(tmp_path, monkeypatch):
    """Return a live view of a leg whose valves' node answers no service; what it waits for is never late."""
    rclpy = pytest.importorskip("rclpy")
    from std_srvs.srv import Trigger

    from pam_orthosis.nodes import live_view

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    for name in ("ANSWER_SECONDS", "HANGS_SECONDS"):
        monkeypatch.setattr(live_view, name, LIMIT_S)
    rclpy.init(args=[], domain_id=own_domain())
    made, silent = live_view.LiveView(), rclpy.create_node("inverse_valve_model")
    for service in live_view.SERVICES.values():
        silent.create_service(Trigger, f"~/{service}", lambda _, answer: answer)  # nobody spins it
    for service in live_view.SERVICES.values():
        ours, _ = made._ends["", service]
        assert ours.wait_for_service(LIMIT_S)
    yield made
    made.close()
    made.destroy_node()
    silent.destroy_node()
    rclpy.shutdown()


def overdue(view):
    """Let the calls that are under way be those that had their time."""
    view._pressed = [one._replace(until=0.0) for one in view._pressed]


def test_a_call_that_nobody_answers_is_forgotten(view):
    said = []
    reader = Thread(target=lambda: said.append(asked(view.server, "POST", "stop")))
    reader.start()
    wait_for(lambda: view._turn() or view._pressed)
    ((client, _),) = view._pressed[0].calls[""]
    assert len(client._pending_requests) == 1
    overdue(view)
    view._turn()
    assert (view._pressed, client._pending_requests) == ([], {})
    reader.join(LIMIT_S)
    assert said == [(200, "nobody answers: does the graph run?")]


@pytest.mark.parametrize(("button", "done"), [("stop", 1), ("reset", 0)])
def test_a_view_that_hangs_is_told_of_and_afterwards_stops_but_resets_nothing(
    view, monkeypatch, button, done
):
    monkeypatch.setattr("pam_orthosis.nodes.live_view.HANGS_SECONDS", 0.1)  # it hangs: any time is enough
    assert asked(view.server, "POST", button) == (200, "no answer within 0.1 s: press again")
    view._turn()
    assert len(view._pressed) == done
    overdue(view)
    view._turn()
    assert view._pressed == []


def test_the_page_hears_of_the_end_also_if_the_view_fails(monkeypatch):
    pytest.importorskip("rclpy")
    from pam_orthosis.nodes import live_view

    def fail(*_):
        raise ValueError("a callback failed")

    ends = []
    made = SimpleNamespace(server=SimpleNamespace(url=""), close=lambda: ends.append("closed"))
    monkeypatch.setattr(live_view, "LiveView", lambda: made)
    monkeypatch.setattr(live_view.process, "start_ros", lambda: None)
    monkeypatch.setattr(live_view.process, "caught_signals", list)
    monkeypatch.setattr(live_view.process, "spin_while", fail)
    with pytest.raises(ValueError, match="a callback failed"):
        live_view.main()
    assert ends == ["closed"]
