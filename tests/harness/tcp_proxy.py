"""A network between two processes: a TCP proxy that can be cut, silent, or gone."""

from __future__ import annotations

import contextlib
import select
import socket
import threading


class TcpProxy:
    """Forwards connections to a port of this machine."""

    def __init__(self, target_port: int) -> None:
        self._target_port = target_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self.silent = False
        """Forwards nothing, and closes nothing: as with a cable that is pulled."""
        self.refusing = False
        """Closes every new connection at once."""
        self._pairs: dict[socket.socket, socket.socket] = {}
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Resets every connection."""
        with self._lock:
            for end in self._pairs:
                # SO_LINGER with 0 s: a reset instead of a goodbye
                end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                end.close()
            self._pairs.clear()

    def end(self) -> None:
        self._ended.set()
        self._thread.join(10.0)
        self.cut()
        self._listener.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            with self._lock:
                ends = [] if self.silent else list(self._pairs)
            with contextlib.suppress(OSError, ValueError):  # an end that `cut` has closed meanwhile
                for ready in select.select([self._listener, *ends], [], [], 0.02)[0]:
                    if ready is self._listener:
                        self._accept()
                    else:
                        self._forward(ready)

    def _accept(self) -> None:
        near, _ = self._listener.accept()
        try:
            if self.refusing:
                raise OSError
            far = socket.create_connection(("127.0.0.1", self._target_port), 1.0)
        except OSError:
            near.close()
            return
        for end in (near, far):
            end.settimeout(1.0)
        with self._lock:
            self._pairs.update({near: far, far: near})

    def _forward(self, end: socket.socket) -> None:
        try:
            data = end.recv(65536)
            if data:
                self._pairs[end].sendall(data)
                return
        except (OSError, KeyError):
            pass
        with self._lock:
            gone: list[socket.socket] = [end]
            other = self._pairs.pop(end, None)
            if other is not None:
                self._pairs.pop(other, None)
                gone.append(other)
            for each in gone:
                each.close()
