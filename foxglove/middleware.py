"""The port over Foxglove's protocol: nodes for a robot that is reached through its foxglove_bridge. Needs no ROS here.

Only topics are read. Services and publishing are not used: a node without `outputs` announces nothing.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Mapping

from ..core.messages import SerializedType
from ..core.port import Answer, Callback, MappingSubscription, Severity
from ..core.values import ABSENT, ConfigError, canonical_type, printable
from ..runtime.bridge.node import BridgeClient, BridgeNode, KnownTopic
from ..runtime.bridge.receivers import BridgeReceiver
from .channels import Channels
from .connection import FoxgloveConnection
from .protocol import Channel

_LARGEST_JSON_BYTES = 1_000_000
"""Larger messages in JSON are not decoded, as over rosbridge: a robot's messages must not delay those of others."""


class FoxgloveMiddleware(BridgeNode):
    """One node for a robot behind a foxglove_bridge; implements `core.port.middleware.Middleware`."""

    _client: FoxgloveClient

    @property
    def _channels(self) -> Channels:
        return self._client.connection.channels

    def _receiver(
        self, topic: str, type_name: str, field: str | None, callback: Callback, *, is_raw: bool = False
    ) -> _Receiver:
        receiver = _Receiver(self, topic, type_name, field, callback)
        receiver.is_raw = is_raw
        return receiver

    def topic_types(self) -> Mapping[str, str]:
        return {topic: channel.raw_format.type_name for topic, channel in self._channels.topics().items()}

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        answer(self._channels.why_silent(topic, type_name))


class FoxgloveClient(BridgeClient[FoxgloveMiddleware]):
    """The connection to one robot's foxglove_bridge, shared by the nodes that `node` makes."""

    connection: FoxgloveConnection
    connection_class = FoxgloveConnection
    node_class = FoxgloveMiddleware
    log_name = "foxglove"

    async def known_topics(self) -> list[KnownTopic]:
        """See `BridgeClient.known_topics`: what the server offers."""
        known = []
        for channel in self.connection.channels.topics().values():
            if not channel.problem:
                raw = channel.raw_format
                definition = () if raw.message_encoding == "json" else (raw.schema, raw.schema_encoding)
                known.append(KnownTopic(channel.topic, raw.type_name, *definition))
        return known


class _Receiver(BridgeReceiver, MappingSubscription):
    """A subscription of a node to one topic: to a field, to arrivals if it is None, or to messages as bytes."""

    largest_bytes = _LARGEST_JSON_BYTES
    is_raw = False
    _said: str | None = None
    """The problem that was logged last."""

    def bind(self, channel: Channel, messages: SerializedType) -> Callable[[bytes], None] | None:
        """Returns what is called with each message of a channel; None, after one ERROR line, if it cannot be read."""
        type_name = channel.raw_format.type_name
        expected = canonical_type(self._type_name)
        try:
            if expected and type_name not in ("", expected):
                raise ConfigError(f"{self.topic}: expected messages of type {expected}, got {type_name}")
            return self._taker(channel, messages)
        except ConfigError as error:
            problem = str(error)
        if problem != self._said:  # logged once
            self._said = problem
            self._node.log(Severity.ERROR, printable(problem))
        return None

    def _taker(self, channel: Channel, messages: SerializedType) -> Callable[[bytes], None]:
        """Returns what is called with each message of a channel; raises ConfigError if it cannot be read."""
        raw = channel.raw_format
        if self.is_raw:
            return lambda data: self._node.call_back(self, (data, raw))
        if self._field is None:
            return lambda data: self._node.call_back(self, 1.0)
        get = messages.field_getter(self._field)
        largest_bytes = _LARGEST_JSON_BYTES if raw.message_encoding == "json" else math.inf

        def take(data: bytes) -> None:
            value: Any = ABSENT  # a message that cannot be read is a sign of life
            if len(data) > largest_bytes:
                self.too_large(len(data))
            else:
                self.note_readable()
                try:
                    value = get(data)
                except ValueError as error:
                    self.note_mismatch(error)
            self._node.call_back(self, value)

        return take
