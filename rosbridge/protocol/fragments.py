"""The operation `fragment`: splitting long messages and joining their fragments."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

from .errors import Id, ProtocolError, shown
from .limits import Limits

__all__ = ["Reassembly", "split"]


def split(text: str, size: int, id: str) -> Iterator[Dict[str, Any]]:  # noqa: A002 - the protocol's word
    """Yields the fragments of a message.

    Args:
        text: the message as JSON.
        size: largest number of characters in one fragment, 1 or more.
        id: identifies the message; unique within the connection.
    """
    total = -(-len(text) // size)
    for number in range(total):
        data = text[number * size : (number + 1) * size]
        yield {"op": "fragment", "id": id, "data": data, "num": number, "total": total}


class _Partial:
    """An incomplete message."""

    def __init__(self, total: int) -> None:
        self.pieces: List[Optional[str]] = [None] * total
        self.missing = total
        self.chars = 0
        self.last_s = 0.0


class Reassembly:
    """Joins the fragments of one connection, within the limits."""

    def __init__(self, limits: Limits) -> None:
        """Starts without fragments."""
        self._limits = limits
        self._partial: Dict[Id, _Partial] = {}
        self.chars = 0
        """Characters of the incomplete messages."""

    def add(self, fragment: Mapping[str, Any], now_s: float) -> Optional[str]:
        """Takes one fragment; returns the message once it is complete. Repeated fragments are ignored.

        Raises:
            ProtocolError: the fragment is invalid, contradicts earlier ones or exceeds a limit; its message is dropped.
        """
        id, data, number, total = _fields(fragment, self._limits)  # noqa: A001 - the protocol's word
        self._expire(now_s)
        partial = self._partial.get(id)
        if partial is None:
            if len(self._partial) >= self._limits.partial_messages:
                self._drop(next(iter(self._partial)))
            partial = self._partial[id] = _Partial(total)
        if len(partial.pieces) != total:
            self._drop(id)
            raise ProtocolError(f"total: expected {len(partial.pieces)} as before, got {total}", "fragment", id)
        partial.last_s = now_s
        if partial.pieces[number] is not None:
            return None
        if self.chars + len(data) > self._limits.message_bytes:
            self._drop(id)
            raise ProtocolError(f"fragments with more than {self._limits.message_bytes} characters", "fragment", id)
        partial.pieces[number] = data
        partial.missing -= 1
        partial.chars += len(data)
        self.chars += len(data)
        if partial.missing:
            return None
        self._drop(id)
        return "".join(piece for piece in partial.pieces if piece is not None)

    def _expire(self, now_s: float) -> None:
        for id, partial in tuple(self._partial.items()):  # noqa: A001 - the protocol's word
            if now_s - partial.last_s > self._limits.fragment_timeout_s:
                self._drop(id)

    def _drop(self, id: Id) -> None:  # noqa: A002 - the protocol's word
        self.chars -= self._partial.pop(id).chars


def _fields(fragment: Mapping[str, Any], limits: Limits) -> Tuple[Id, str, int, int]:
    id, data = fragment.get("id"), fragment.get("data")  # noqa: A001 - the protocol's word
    if not isinstance(id, (str, int)) or isinstance(id, bool):
        raise ProtocolError(f"id: expected a string or an integer, got {shown(id)}", "fragment")
    if isinstance(id, str) and len(id) > limits.name_chars:
        raise ProtocolError(f"id: expected at most {limits.name_chars} characters", "fragment")
    if not isinstance(data, str):
        raise ProtocolError(f"data: expected a string, got {shown(data)}", "fragment", id)
    number, total = _whole(fragment.get("num")), _whole(fragment.get("total"))
    if total is None or not 1 <= total <= limits.fragments:
        raise ProtocolError(
            f"total: expected 1 to {limits.fragments}, got {shown(fragment.get('total'))}", "fragment", id
        )
    if number is None or not 0 <= number < total:
        raise ProtocolError(f"num: expected 0 to {total - 1}, got {shown(fragment.get('num'))}", "fragment", id)
    return id, data, number, total


def _whole(value: object) -> Optional[int]:
    """Returns an integer, rounded down: the reference server sends 3.75 as the total of 3 fragments."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    if isinstance(value, float) and not -1e9 < value < 1e9:
        return None
    return int(value)
