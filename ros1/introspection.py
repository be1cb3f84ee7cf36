"""What a rosbridge server needs in addition to the port, over rospy: the graph, service calls, raw messages."""

from __future__ import annotations

import socket
import struct
import time
from urllib.parse import urlsplit

import genpy
import rosgraph.network
import rospy

from ..core.messages.dialect import Message
from ..core.messages.raw_messages import RawFormat
from ..core.port import Graph, NodeInfo
from ..core.values import ConfigError, MessageError, ServiceError
from . import messages
from .middleware import Ros1Middleware

_RECEIVE_BYTES = 65_536
_MAX_RESPONSE_BYTES = 64_000_000
_ANY_MD5 = "*"


class Ros1ServedMiddleware(Ros1Middleware):
    """A logical node that can be served; implements `core.middleware.ServedMiddleware`."""

    def graph(self) -> Graph:
        """As `core.middleware.ServedMiddleware`; the master does not know the types of services."""
        publishers, subscribers, services = self._master.system_state()
        nodes: dict[str, list[list[str]]] = {}
        for kind, state in enumerate((publishers, subscribers, services)):
            for name, users in state:
                for user in users:
                    nodes.setdefault(user, [[], [], []])[kind].append(name)
        return Graph(
            self.topic_types(),
            {service: "" for service, _ in services},
            {name: NodeInfo(*lists) for name, lists in nodes.items()},
        )

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """As `core.middleware.ServedMiddleware`. Not through rospy, whose calls wait forever for the response."""
        resolved = rospy.resolve_name(self._resolve(service))
        deadline_s = time.monotonic() + timeout_s
        try:
            address = self._master.find_service(resolved)
            if address is None:
                raise ServiceError("no such service")
            return _call(resolved, address, type_name, request, deadline_s)
        except MessageError as error:
            raise MessageError(f"{resolved}: {error}") from None
        except (ServiceError, ConfigError) as error:
            raise ServiceError(f"{resolved}: {error}") from None
        except (TimeoutError, socket.timeout):  # one class from Python 3.10 on
            raise ServiceError(f"{resolved}: no response within {timeout_s:g} s") from None
        except (OSError, ValueError, genpy.MessageException, rosgraph.network.ROSHandshakeException) as error:
            raise ServiceError(f"{resolved}: the call failed: {error}") from None

    def raw_format(self, type_name: str) -> RawFormat:
        return messages.raw_format(type_name)


def _call(service: str, address: str, type_name: str, request: Message, deadline_s: float) -> Message:
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
    return messages.to_mapping(messages.deserialized(data, cls._response_class))


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
