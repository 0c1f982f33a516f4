"""The page of `driftplan.page` on the loopback address, under a name that nobody can guess."""

from __future__ import annotations

import json
import secrets
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from driftplan.page.scene import Scene, page
from driftplan.report.studio.answers import Answers

_MAX_BYTES = 64 << 20  # of a question


class StudioServer(ThreadingHTTPServer):
    """Serves one page at `url` and answers what it asks; no file of this machine is ever sent.

    Whoever does not know the token in the URL gets nothing, and what another site's page sends is refused.
    """

    daemon_threads = True  # a search does not outlive the command

    def __init__(self, scene: Scene, answers: Answers, port: int = 0):
        super().__init__(("127.0.0.1", port), _Requests)
        self.answers, self.page = answers, page(scene, asks=True, saves=answers.save is not None)
        self.root = f"/{secrets.token_urlsafe(24)}/"
        self.url = f"http://127.0.0.1:{self.server_port}{self.root}"


class _Requests(BaseHTTPRequestHandler):
    server: StudioServer

    def do_GET(self) -> None:
        if self._is_ours(self.path):
            self._send(200, "text/html; charset=utf-8", self.server.page)
        else:
            self._send(404, "text/plain", b"nothing here")

    def do_POST(self) -> None:
        """Answers with lines of JSON: progress, then the answer or an error. A page that hangs up ends the search."""
        root, _, what = self.path.partition("ask/")
        is_json = self.headers.get("Content-Type") == "application/json"  # a form of another site cannot send that
        size = self.headers.get("Content-Length", "")
        if not (self._is_ours(root) and is_json and size.isdecimal() and int(size) <= _MAX_BYTES):
            return self._send(404, "text/plain", b"nothing here")
        try:
            question = json.loads(self.rfile.read(int(size)))
        except (ValueError, RecursionError):
            return self._send(400, "text/plain", b"expected JSON")
        self._send(200, "application/x-ndjson")
        return self._line(self.server.answers.answer(what, question, lambda news: self._line({"progress": news})))

    def _line(self, message: dict[str, Any]) -> None:
        self.wfile.write(json.dumps(message).encode() + b"\n")

    def _is_ours(self, path: str) -> bool:
        """Whether the token is there, and the browser knows whom it talks to: no name that someone points here."""
        hosts = [f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")]
        return secrets.compare_digest(path.encode(), self.server.root.encode()) and self.headers.get("Host") in hosts

    def _send(self, status: int, kind: str, body: bytes = b"") -> None:
        """The answer, or the beginning of one that goes on until the connection ends (HTTP/1.0)."""
        self.send_response(status)
        headers = {"Content-Type": kind, "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def handle(self) -> None:
        try:
            super().handle()
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True  # it hung up

    def log_message(self, *_: object) -> None:
        """Nothing: the URL holds the token."""
