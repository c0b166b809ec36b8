# SPDX-License-Identifier: Apache-2.0
"""The live view's web server: one page, what it shows as server-sent events, its buttons.

It listens on this host only. Who wants anything must know the token in the address, and no page of another
origin or under another name of this host is answered: nothing else in the browser can press a button.
"""

import json
import secrets
import sys
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Condition, Thread
from typing import Any

HOST = "127.0.0.1"
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

Act = Callable[[], str]


class LiveServer:
    """Serves a page, and the newest of what is said to it, until closed; a POST to a name does an act."""

    def __init__(self, page: str, acts: dict[str, Act]):
        self.page, self.acts, self.token = page, acts, secrets.token_urlsafe(16)
        self._news, self._count, self._said = Condition(), 0, ""
        self._over, self._readers = False, 0
        self._server = _Server((HOST, 0), partial(_Handler, self))
        self.port = self._server.server_address[1]
        Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def say(self, news: Any, last: bool = False) -> None:
        """Let all pages know; one that is slow hears the newest only."""
        with self._news:
            self._count, self._said, self._over = self._count + 1, json.dumps(news), last
            self._news.notify_all()

    def follow(self, send: Callable[[str], None]) -> None:
        """Send news as they come, from the newest on, until the last."""
        seen = 0
        with self._news:
            self._readers += 1
        try:
            while True:
                with self._news:
                    fresh = self._news.wait_for(partial(self._newer, seen), 5.0)
                    seen, said, over = self._count, self._said, self._over
                send(f"data: {said}\n\n" if fresh else ":\n\n")
                if over:
                    return
        finally:
            with self._news:
                self._readers -= 1
                self._news.notify_all()

    def _newer(self, seen: int) -> bool:
        return self._count > seen

    def close(self) -> None:
        """End, when all pages have heard what was said last, or soon."""
        with self._news:
            self._news.wait_for(lambda: not (self._over and self._readers), 1.0)
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, *request: Any) -> None:
        """Report what fails, but not that a page was closed."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(*request)


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, live: LiveServer, *arguments: Any):
        self._live = live
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """Answer with the page or the events."""
        if (name := self._name()) is None:
            return
        if name == "events":
            self._head(HTTPStatus.OK, "text/event-stream")
            self._live.follow(self._send)
        elif name:
            self._answer(HTTPStatus.NOT_FOUND, "there is no such page")
        else:
            self._answer(HTTPStatus.OK, self._live.page, "text/html")

    def do_POST(self) -> None:
        """Do what a button is for."""
        if (name := self._name()) is None:
            return
        if act := self._live.acts.get(name):
            self._answer(HTTPStatus.OK, act())
        else:
            self._answer(HTTPStatus.NOT_FOUND, "there is no such button")

    def _name(self) -> str | None:
        """Return what is asked for; None if it is refused, which is answered."""
        own = {f"{host}:{self._live.port}" for host in (HOST, "localhost")}
        origin = self.headers.get("Origin")
        _, token, name = [*self.path.split("/", 2), "", ""][:3]
        right = secrets.compare_digest(token.encode(), self._live.token.encode())
        if right and self.headers.get("Host") in own and (origin is None or origin.split("//")[-1] in own):
            return name
        self._answer(HTTPStatus.FORBIDDEN, "refused: open the address that was printed")
        return None

    def _answer(self, status: HTTPStatus, text: str, kind: str = "text/plain") -> None:
        body = text.encode()
        self._head(status, kind, {"Content-Length": str(len(body))})
        self.wfile.write(body)

    def _head(self, status: HTTPStatus, kind: str, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {"Content-Type": f"{kind}; charset=utf-8", **HEADERS, **(more or {})}.items():
            self.send_header(name, value)
        self.end_headers()

    def _send(self, text: str) -> None:
        self.wfile.write(text.encode())

    def log_message(self, *_: Any) -> None:
        """Say nothing of requests."""
