"""A real HTTP server for tests, which records requests and misbehaves on demand."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from queue import Queue
from typing import Any, Callable, Mapping, NamedTuple

DEADLINE_S = 30.0


class Received(NamedTuple):
    """A request that the server received."""

    method: str
    path: str
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


Behaviour = Callable[["Handler"], None]


class Handler(BaseHTTPRequestHandler):
    """Records a request and behaves as the server is told."""

    owner: HttpServer
    protocol_version = "HTTP/1.1"

    def handle_any(self) -> None:
        self.close_connection = True
        size = int(self.headers.get("Content-Length", 0))
        body = self.rfile.read(size)
        if len(body) < size:
            return  # the client was killed while it sent the request
        self.owner.received.put(Received(self.command, self.path, dict(self.headers.items()), body))
        try:
            self.owner.behave(self)
        except (BrokenPipeError, ConnectionResetError):
            pass  # the client has closed the connection

    do_GET = do_POST = handle_any  # noqa: N815  # names given by the standard library

    def log_message(self, *arguments: object) -> None:
        """Writes nothing."""

    def respond(self, status: int, body: bytes = b"", headers: dict[str, str] | None = None) -> None:
        self.send_response_only(status)
        own = {"Date": self.date_time_string(), "Content-Length": str(len(body))}
        for name, value in {**own, **(headers or {})}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)


class ManyAtOnce(ThreadingHTTPServer):
    """Refuses no connection while many clients come at once."""

    daemon_threads = True
    request_queue_size = 100


class HttpServer:
    """Listens on a free port of 127.0.0.1 while it is entered as a context."""

    def __init__(self) -> None:
        self.received: Queue[Received] = Queue()
        self.behave: Behaviour = responding(200)
        self.closing = threading.Event()
        """Ends behaviours that would last for ever."""
        handler: type[Handler] = type("BoundHandler", (Handler,), {"owner": self})
        self._server = ManyAtOnce(("127.0.0.1", 0), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def next(self) -> Received:
        """Waits for a request."""
        return self.received.get(timeout=DEADLINE_S)

    def all(self) -> list[Received]:
        """Returns the requests that have come and were not taken yet."""
        return [self.received.get() for _ in range(self.received.qsize())]

    def __enter__(self) -> HttpServer:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()


def responding(status: int, body: bytes = b"", **headers: str) -> Behaviour:
    """Responds with a status; `_` in names of headers stands for `-`."""
    return lambda handler: handler.respond(status, body, {name.replace("_", "-"): headers[name] for name in headers})


def hanging(handler: Handler) -> None:
    """Never responds."""
    handler.owner.closing.wait()


def closing_at_once(handler: Handler) -> None:
    """Closes the connection without a response."""


def dripping(handler: Handler) -> None:
    """Sends a header without end, byte by byte: each byte arrives in time, the response never does."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX: ")
    while not handler.owner.closing.wait(0.01):
        handler.wfile.write(b"x")


def flooding(handler: Handler) -> None:
    """Sends a body without end."""
    handler.wfile.write(b"HTTP/1.1 500 Internal Server Error\r\n\r\n")
    while not handler.owner.closing.is_set():
        handler.wfile.write(b"x" * 65536)


def redirecting_to_itself(handler: Handler) -> None:
    """Redirects in a loop."""
    handler.respond(302, headers={"Location": handler.path})


def garbling(handler: Handler) -> None:
    """Responds with something else than HTTP."""
    handler.wfile.write(b"SSH-2.0-OpenSSH_9.6\r\n\r\n")
