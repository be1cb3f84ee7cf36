"""Finds the topic of a large message without decoding the message.

Servers write `op` and `topic` before `msg`. Only the members before `msg` are looked at, and at most 2,048 bytes.
"""

from __future__ import annotations

import json
import re
from typing import Dict, Optional, Tuple

from ..protocol import Wire

__all__ = ["HEAD_BYTES", "topic_of_message"]

HEAD_BYTES = 2_048

_KEY = re.compile(r'[\s,]*"(\w{1,32})"\s*:\s*')
_STRING = re.compile(r'"(?:[^"\\\x00-\x1f]|\\.)*"')


def topic_of_message(data: Wire) -> Optional[str]:
    """Returns the topic of a `publish` operation; None if this is not one, or its topic comes after `msg`.

    Args:
        data: JSON or CBOR, of any size; it need not be valid.
    """
    head = data[:HEAD_BYTES]
    members = _members_of_json(head) if isinstance(head, str) else _members_of_cbor(head)
    return members.get("topic") if members.get("op") == "publish" else None


def _members_of_json(text: str) -> Dict[str, str]:
    members: Dict[str, str] = {}
    start = re.match(r"\s*\{", text)
    position = start.end() if start else len(text)
    while True:
        key = _KEY.match(text, position)
        value = _STRING.match(text, key.end()) if key else None
        if key is None or value is None:
            return members
        position = value.end()
        try:
            members[key[1]] = json.loads(value[0])
        except ValueError:
            return members


def _members_of_cbor(data: bytes) -> Dict[str, str]:
    """Reads pairs of texts from the start of a CBOR map (RFC 8949: major type 5 is a map, 3 a text)."""
    members: Dict[str, str] = {}
    if not data or data[0] >> 5 != 5:
        return members
    position = 1 + {24: 1, 25: 2, 26: 4, 27: 8}.get(data[0] & 31, 0)
    while True:
        key, position = _text_of_cbor(data, position)
        value, position = _text_of_cbor(data, position)
        if key is None or value is None:
            return members
        members[key] = value


def _text_of_cbor(data: bytes, position: int) -> Tuple[Optional[str], int]:
    """Returns the text at a position and where it ends; None if there is no complete text."""
    if position >= len(data) or data[position] >> 5 != 3:
        return None, position
    length, start = data[position] & 31, position + 1
    if length in (24, 25):
        width = 1 if length == 24 else 2
        length, start = int.from_bytes(data[start : start + width], "big"), start + width
    elif length > 25:
        return None, position
    text = data[start : start + length]
    if len(text) < length:
        return None, position
    try:
        return text.decode("utf-8"), start + length
    except UnicodeDecodeError:
        return None, position
