# SPDX-License-Identifier: Apache-2.0
"""The live view's web server: who knows the address is answered, nobody else, from this host alone."""

import json
from http.client import HTTPConnection
from threading import Event, Thread

import pytest

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
    connection = HTTPConnection("127.0.0.1", server.port, timeout=60)
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
