"""A transport under the control of a test."""

from __future__ import annotations


class SlowTransport:
    """A transport whose buffer empties when the test says so; a real one cannot be stopped at a byte."""

    def __init__(self, buffered: int = 0) -> None:
        self.buffered = buffered
        self.written: list[bytes] = []
        self.breaks = False
        """Whether the next write finds that the client has gone."""
        self.closing = False

    def write(self, data: bytes) -> None:
        self.written.append(bytes(data))
        if self.breaks:
            self.closing = True
        else:
            self.buffered += len(data)

    def set_write_buffer_limits(self, high: int) -> None:
        """The test empties the buffer."""

    def is_closing(self) -> bool:
        return self.closing

    def get_write_buffer_size(self) -> int:
        return self.buffered
