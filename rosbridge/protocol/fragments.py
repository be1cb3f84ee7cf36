"""Messages in pieces: rosbridge's operation `fragment`, both ways."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

from .errors import Id, ProtocolError, shown
from .limits import Limits


def split(text: str, size: int, id: str) -> Iterator[Dict[str, Any]]:  # noqa: A002 - the protocol's own word
    """Yields `text` as fragments of at most `size` characters of data each.

    Args:
        text: the whole message as JSON.
        size: most characters of data in one fragment, 1 or more.
        id: what joins them; no other message of this connection may have it.
    """
    total = -(-len(text) // size)
    for number in range(total):
        data = text[number * size : (number + 1) * size]
        yield {"op": "fragment", "id": id, "data": data, "num": number, "total": total}


class _Partial:
    """One message whose fragments are still coming."""

    def __init__(self, total: int) -> None:
        self.pieces: List[Optional[str]] = [None] * total
        self.missing = total
        self.chars = 0
        self.last_s = 0.0


class Reassembly:
    """Joins the fragments of one connection; memory is bounded by `Limits`."""

    def __init__(self, limits: Limits) -> None:
        """Starts with nothing."""
        self._limits = limits
        self._partial: Dict[Id, _Partial] = {}
        self._chars = 0

    def add(self, fragment: Mapping[str, Any], now_s: float) -> Optional[str]:
        """Takes one fragment; returns the whole message when it was the last one missing.

        A fragment that came before is ignored.

        Raises:
            ProtocolError: it is not a fragment, contradicts the others, or goes beyond the limits; what was there of
                its message is dropped then.
        """
        id, data, number, total = _fields(fragment, self._limits)  # noqa: A001 - the protocol's own word
        self._expire(now_s)
        partial = self._partial.get(id)
        if partial is None:
            if len(self._partial) >= self._limits.partial_messages:
                self._drop(next(iter(self._partial)))
            partial = self._partial[id] = _Partial(total)
        if len(partial.pieces) != total:
            self._drop(id)
            raise ProtocolError(f"found {total} as total where it was {len(partial.pieces)}", "fragment", id)
        partial.last_s = now_s
        if partial.pieces[number] is not None:
            return None
        if self._chars + len(data) > self._limits.message_bytes:
            self._drop(id)
            raise ProtocolError(f"fragments hold more than {self._limits.message_bytes} characters", "fragment", id)
        partial.pieces[number] = data
        partial.missing -= 1
        partial.chars += len(data)
        self._chars += len(data)
        if partial.missing:
            return None
        self._drop(id)
        return "".join(piece for piece in partial.pieces if piece is not None)

    def _expire(self, now_s: float) -> None:
        for id, partial in tuple(self._partial.items()):  # noqa: A001 - the protocol's own word
            if now_s - partial.last_s > self._limits.fragment_timeout_s:
                self._drop(id)

    def _drop(self, id: Id) -> None:  # noqa: A002 - the protocol's own word
        self._chars -= self._partial.pop(id).chars


def _fields(fragment: Mapping[str, Any], limits: Limits) -> Tuple[Id, str, int, int]:
    id, data = fragment.get("id"), fragment.get("data")  # noqa: A001 - the protocol's own word
    if not isinstance(id, (str, int)) or isinstance(id, bool):
        raise ProtocolError(f"found {shown(id)} as id, allowed is a text", "fragment")
    if isinstance(id, str) and len(id) > limits.name_chars:
        raise ProtocolError(f"the id is longer than {limits.name_chars} characters", "fragment")
    if not isinstance(data, str):
        raise ProtocolError(f"found {shown(data)} as data, allowed is a text", "fragment", id)
    number, total = _whole(fragment.get("num")), _whole(fragment.get("total"))
    if total is None or not 1 <= total <= limits.fragments:
        raise ProtocolError(
            f"found {shown(fragment.get('total'))} as total, allowed is 1 to {limits.fragments}", "fragment", id
        )
    if number is None or not 0 <= number < total:
        raise ProtocolError(f"found {shown(fragment.get('num'))} as num, allowed is 0 to {total - 1}", "fragment", id)
    return id, data, number, total


def _whole(value: object) -> Optional[int]:
    """Returns a whole number; the reference server sends `total` as 3.75 for 3 fragments, so floats are cut."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    if isinstance(value, float) and not -1e9 < value < 1e9:
        return None
    return int(value)
