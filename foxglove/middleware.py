"""The port over Foxglove's protocol: nodes for a robot that is reached through its foxglove_bridge. Needs no ROS here.

Only topics are read. Services and publishing are not used: a node without `outputs` announces nothing.
"""

from __future__ import annotations

import abc
import math
from typing import Any, Callable, List, Mapping, Optional

from ..core.messages.standard_messages import check_field, check_type
from ..core.port.hints import Answer
from ..core.port.mapping_node import CLOCK
from ..core.port.middleware import Callback, RawCallback, Severity
from ..core.values.errors import ConfigError, MessageError
from ..core.values.field_path import ABSENT
from ..core.values.formatting import printable
from ..core.values.model import Level
from ..core.values.names import canonical_type
from ..runtime.bridge.node import BridgeClient, BridgeNode, KnownTopic
from .channels import Messages
from .connection import FoxgloveConnection
from .protocol import Channel

_LARGEST_JSON_BYTES = 1_000_000
"""Larger messages in JSON are not decoded, as over rosbridge: a robot's messages must not delay those of others."""


class FoxgloveClient(BridgeClient["FoxgloveMiddleware"]):
    """The connection to one robot's foxglove_bridge, shared by the nodes that `node` makes."""

    connection: FoxgloveConnection
    connection_class = FoxgloveConnection
    log_name = "foxglove"

    def _new_node(self, name: str, *binding: Any) -> FoxgloveMiddleware:
        return FoxgloveMiddleware(self, name, *binding)

    async def known_topics(self) -> List[KnownTopic]:
        """See `BridgeClient.known_topics`: what the server offers."""
        known = []
        for channel in self.connection.channels.topics().values():
            if not channel.problem:
                schema = "" if channel.encoding == "json" else channel.schema
                known.append(KnownTopic(channel.topic, channel.type_name, schema, channel.form))
        return known


class FoxgloveMiddleware(BridgeNode):
    """One node for a robot behind a foxglove_bridge; implements `core.port.middleware.Middleware`."""

    _client: FoxgloveClient

    def __init__(self, client: FoxgloveClient, name: str, *binding: Any) -> None:
        """Use `FoxgloveClient.node`."""
        super().__init__(client, name, *binding)
        self._channels = client.connection.channels
        self._clock_receiver = _ClockReceiver(self)
        if self._sim_time_s is not None:
            self._channels.add(self._clock_receiver)

    def _new_receiver(self, topic: str, type_name: str, field: Optional[str], callback: Callback) -> _FieldReceiver:
        if type_name:
            check_field(topic, type_name, field or "")
        return _FieldReceiver(self, topic, type_name, field, callback)

    def _new_capture(self, topic: str, type_name: str, callback: RawCallback) -> _CaptureReceiver:
        return _CaptureReceiver(self, topic, type_name, callback)

    def _add(self, type_name: str, receiver: Any) -> None:
        self._channels.add(receiver)

    def _remove(self, receiver: Any) -> None:
        self._channels.remove(receiver)

    def _close_on_robot(self) -> None:
        if self._sim_time_s is not None:
            self._channels.remove(self._clock_receiver)

    def topic_types(self) -> Mapping[str, str]:
        return {topic: channel.type_name for topic, channel in self._channels.topics().items()}

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        own = [*self._advertised, *(subscription.topic for subscription in tuple(self._subscriptions))]
        self._client.run_in_loop(lambda: answer(self._channels.why_silent(topic, type_name, own)))


class _Receiver(abc.ABC):
    """A subscription of a node to one topic."""

    dropped = 0

    def __init__(self, node: FoxgloveMiddleware, topic: str, type_name: str, callback: Callback) -> None:
        """Binds the resolved topic and its type, which is empty if any is taken."""
        if type_name:
            check_type(type_name)
        self.topic = topic
        self.active = True
        self.callback = callback
        self._node = node
        self._type_name = canonical_type(type_name)
        self._said: Optional[str] = None

    def end(self) -> None:
        """Ends the subscription."""
        self.active = False

    def bind(self, channel: Channel, messages: Messages) -> Optional[Callable[[bytes], None]]:
        """Returns what is called with each message of a channel; None, after one ERROR line, if it cannot be read."""
        if self._type_name and channel.type_name and channel.type_name != self._type_name:
            self._say(f"{self.topic}: expected messages of type {self._type_name}, got {channel.type_name}")
            return None
        try:
            return self._taker(channel, messages)
        except ConfigError as error:
            self._say(str(error))
            return None

    @abc.abstractmethod
    def _taker(self, channel: Channel, messages: Messages) -> Callable[[bytes], None]:
        """Returns what is called with each message of a channel; raises ConfigError if it cannot be read."""

    def _say(self, text: str) -> None:
        """Logs a problem once."""
        if text != self._said:
            self._said = text
            self._node.log(Severity.ERROR, printable(text))


class _FieldReceiver(_Receiver):
    """Reads one field, or counts arrivals if it is None."""

    def __init__(
        self, node: FoxgloveMiddleware, topic: str, type_name: str, field: Optional[str], callback: Callback
    ) -> None:
        super().__init__(node, topic, type_name, callback)
        self._field = field
        self._fault = f"topic {topic}"
        self._has_mismatch = False

    def _taker(self, channel: Channel, messages: Messages) -> Callable[[bytes], None]:
        if self._field is None:
            return lambda data: self._node.call_back(self, 1.0)
        get = messages.getter(self._field)
        largest_bytes = _LARGEST_JSON_BYTES if channel.encoding == "json" else math.inf

        def take(data: bytes) -> None:
            if len(data) > largest_bytes:
                self._drop(len(data))
                return
            try:
                value = get(data)
            except (ValueError, MessageError) as error:
                if not self._has_mismatch:
                    self._has_mismatch = True
                    text = f"{self.topic}: a message does not match its type: {error}"
                    self._node.log(Severity.ERROR, printable(text))
                value = ABSENT
            self._node.call_back(self, value)

        return take

    def _drop(self, size_bytes: int) -> None:
        self.dropped += 1
        sizes = f"the last of {size_bytes / 1e6:.1f} MB (limit {_LARGEST_JSON_BYTES / 1e6:.1f} MB)"
        self._node.faults.report(self._fault, f"dropped {self.dropped} messages, {sizes}", Level.WARN)

    def end(self) -> None:
        """Ends the subscription and its fault."""
        super().end()
        self._node.faults.clear(self._fault)


class _CaptureReceiver(_Receiver):
    """Passes the messages on as bytes."""

    def _taker(self, channel: Channel, messages: Messages) -> Callable[[bytes], None]:
        raw = channel.raw_format
        return lambda data: self._node.call_back(self, (data, raw))


class _ClockReceiver(_Receiver):
    """Follows /clock."""

    def __init__(self, node: FoxgloveMiddleware) -> None:
        super().__init__(node, CLOCK, "", _nothing)

    def _taker(self, channel: Channel, messages: Messages) -> Callable[[bytes], None]:
        get = messages.getter("")

        def take(data: bytes) -> None:
            try:
                self._node.take_clock(get(data))
            except (ValueError, MessageError) as error:
                self._say(f"{CLOCK}: a message does not match its type: {error}")

        return take


def _nothing(value: Any, now_s: float) -> None:
    """Is called with nothing."""
