"""WebSocket frames, made once for any number of clients.

aiohttp's own writer makes them: it is given a transport that keeps what is written. A frame from a server is not masked
(RFC 6455, section 5.1), so the same bytes do for every client.
"""

from __future__ import annotations

from typing import Any, Coroutine, List, Union

from aiohttp import WSMsgType
from aiohttp.http import WebSocketWriter


class _Paper:
    """The part of a transport that the writer uses."""

    def __init__(self) -> None:
        self.written: List[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(bytes(data))

    def is_closing(self) -> bool:
        return False


class _NeverFull:
    """The part of a protocol that the writer uses, for flow control, which is not wanted here."""

    _paused = False

    async def _drain_helper(self) -> None:
        return None


class FrameMaker:
    """Turns messages into the bytes that go over the socket."""

    def __init__(self) -> None:
        """Makes a writer that writes on paper."""
        self._paper = _Paper()
        # The writer's parameters are a protocol and a transport of asyncio; it uses no more of them than is here.
        self._writer: Any = WebSocketWriter(_NeverFull(), self._paper, use_mask=False)  # type: ignore[arg-type]
        self._by_opcode = hasattr(self._writer, "send_frame")

    def frame(self, message: Union[str, bytes]) -> bytes:
        """Returns one message as one frame: text, or binary for bytes."""
        binary = isinstance(message, bytes)
        data = message if isinstance(message, bytes) else message.encode("utf-8")
        if self._by_opcode:  # aiohttp 3.11 and newer
            _run(self._writer.send_frame(data, WSMsgType.BINARY if binary else WSMsgType.TEXT))
        else:
            _run(self._writer.send(data, binary=binary))
        frame = b"".join(self._paper.written)
        self._paper.written.clear()
        return frame


def _run(coroutine: Coroutine[Any, Any, None]) -> None:
    """Runs a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration:
        return
    coroutine.close()
    raise RuntimeError("the WebSocket writer waits although nothing is full")
