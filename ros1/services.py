"""Calls of services that end in time. rospy's own wait forever for the response."""

from __future__ import annotations

import socket
import struct
import time
from urllib.parse import urlsplit

import rosgraph.network
import rospy

from ..core.values import Message, ServiceError
from . import messages

_RECEIVE_BYTES = 65_536
_MAX_RESPONSE_BYTES = 64_000_000
_ANY_MD5 = "*"


def call_in_time(service: str, address: str, type_name: str, request: Message, deadline_s: float) -> Message:
    """Calls a service over TCPROS (https://wiki.ros.org/ROS/TCPROS).

    Raises ConfigError if its type is not known here, ServiceError if it reports an error, TimeoutError or
    socket.timeout after the deadline.
    """
    parts = urlsplit(address)
    with socket.create_connection((parts.hostname or "", parts.port or 0), _left_s(deadline_s)) as connection:
        cls = messages.service_class(type_name) if type_name else None
        checksum = _ANY_MD5 if cls is None else cls._md5sum
        header = {"callerid": rospy.get_name(), "service": service, "md5sum": checksum}
        rosgraph.network.write_ros_handshake_header(connection, header)
        (length,) = struct.unpack("<I", _receive(connection, 4, deadline_s))
        answer = rosgraph.network.decode_ros_handshake_header(
            struct.pack("<I", length) + _receive(connection, length, deadline_s)
        )
        if "error" in answer:
            raise ServiceError(answer["error"])
        cls = cls or messages.service_class(answer.get("type", ""))
        data = messages.serialized(messages.to_native(cls._request_class, request))
        connection.sendall(struct.pack("<I", len(data)) + data)
        succeeded, length = struct.unpack("<BI", _receive(connection, 5, deadline_s))
        data = _receive(connection, length, deadline_s)
    if not succeeded:
        raise ServiceError(data.decode("utf-8", "replace"))
    return messages.to_mapping(cls._response_class().deserialize(data))


def _receive(connection: socket.socket, length: int, deadline_s: float) -> bytes:
    if length > _MAX_RESPONSE_BYTES:
        raise ServiceError(f"expected a response of at most {_MAX_RESPONSE_BYTES} bytes, got {length}")
    parts: list[bytes] = []
    while length:
        connection.settimeout(_left_s(deadline_s))
        part = connection.recv(min(length, _RECEIVE_BYTES))
        if not part:
            raise ServiceError("the service closed the connection without a response")
        parts.append(part)
        length -= len(part)
    return b"".join(parts)


def _left_s(deadline_s: float) -> float:
    left_s = deadline_s - time.monotonic()
    if left_s <= 0.0:
        raise TimeoutError
    return left_s
