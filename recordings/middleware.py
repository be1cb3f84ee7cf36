"""The port over recordings: messages and time come from files.

A `Player` reads recordings once and delivers each message to its nodes at the message's log time. Timers run in
between, at their own periods, so that a node decides what it would have decided live. A recording that ends is not
silence: time ends with it.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Mapping, Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.field_path import ABSENT
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.mapping_node import CLOCK, MappingNode
from robot_health_monitor.core.middleware import Message, Severity

from .decoding import types_of
from .reading import Recordings
from .recording import Channel, canonical_type

Callback = Callable[[Any, float], None]


class Subscription:
    """A node's subscription to a recorded topic; implements `core.middleware.Subscription`."""

    def __init__(self, node: RecordedMiddleware, topic: str, callback: Callback) -> None:
        """Stores where messages are delivered."""
        self.topic = topic
        self.node = node
        self.callback = callback
        self.active = True

    def deliver(self, value: Any) -> None:
        """Passes a value to the node, unless the subscription has ended."""
        if self.active:
            self.node.call_back(self, value)


class _ClockSubscription(Subscription):
    """Passes simulated time to a node, which waits for it before anything else."""

    def deliver(self, value: Any) -> None:
        self.node.take_clock(value)


class _Reader:
    """One field of one channel: read once per message, delivered to every subscription."""

    def __init__(self, channel: Channel, field: Optional[str]) -> None:
        self.topic = channel.topic
        self.get: Callable[[bytes], Any] = _arrival if field is None else types_of(channel).field_getter(field)
        self.subscriptions: List[Subscription] = []


class RecordedMiddleware(MappingNode):
    """One node that receives recorded messages; implements `core.middleware.Middleware`.

    What it publishes has no listeners, and its services have no callers.
    """

    def __init__(self, player: Player, name: str, parameters: Mapping[str, Any], use_sim_time: bool) -> None:
        """Use `Player.node`."""
        super().__init__(name, parameters, {}, clock=lambda: player.wall_s, use_sim_time=use_sim_time)
        self._player = player

    def advertise(self, topic: str, type_name: str) -> None:
        self._advertised[self.resolve(topic)] = type_name

    def publish(self, topic: str, message: Message) -> None:
        self.require_advertised(topic)

    def has_listeners(self, topic: str) -> bool:
        self.require_advertised(topic)
        return False

    def subscribe(self, topic: str, type_name: str, callback: Callback, *, field: Optional[str] = "") -> Subscription:
        return self._player.subscribe(Subscription(self, self.resolve(topic), callback), type_name, field)

    def unsubscribe(self, subscription: Any) -> None:
        subscription.active = False

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        """Does nothing: a recording calls no services."""

    def log(self, severity: Severity, text: str) -> None:
        self._player.on_log(LogLine(self.now_s(), self.name, severity, text))

    def close(self) -> None:
        self.closed = True
        self.cancel_timers()


class Player:
    """Plays recordings to nodes, as fast as they can be read."""

    def __init__(
        self,
        recordings: Recordings,
        *,
        namespace: str = "",
        from_s: float = 0.0,
        to_s: float = math.inf,
        use_sim_time: bool = False,
        on_log: Optional[Callable[[LogLine], None]] = None,
    ) -> None:
        """Prepares to play; time stands at the start.

        Args:
            recordings: what to play.
            namespace: namespace of the nodes.
            from_s: where to begin, in seconds since the start of the recordings.
            to_s: where to end, in seconds since the start of the recordings.
            use_sim_time: take the time from the recorded topic /clock.
            on_log: called with every line that a node logs.

        Raises:
            ConfigError: simulated time is requested and /clock is not recorded.
        """
        self._recordings = recordings
        self._namespace = namespace.strip("/")
        span = recordings.span_ns or (0, 0)
        self._start_ns = span[0] + round(from_s * 1e9)
        self._end_ns = min(span[1], span[0] + round(to_s * 1e9)) if to_s < math.inf else span[1]
        self._use_sim_time = use_sim_time
        self.wall_s = self._start_ns / 1e9
        """Log time of the message that is being played, in seconds since 1970."""
        self.late = 0
        """How many messages came out of the order of their log times; they were delivered late."""
        self.undecodable: Dict[str, int] = {}
        """How many messages of a topic did not match its type."""
        self.on_log: Callable[[LogLine], None] = on_log or _ignore
        self._nodes: List[RecordedMiddleware] = []
        self._due_s = -math.inf
        """When the next timer of a node is due."""
        self._channels: Dict[str, List[Channel]] = {}
        for channel in recordings.channels:
            self._channels.setdefault(channel.topic, []).append(channel)
        self._readers: Dict[Channel, Dict[Optional[str], _Reader]] = {}
        if use_sim_time and not self._channels.get(CLOCK):
            raise ConfigError("simulated time was requested, but the recordings have no topic /clock")

    @property
    def end_s(self) -> float:
        """Log time at which playing ends, in seconds since 1970."""
        return self._end_ns / 1e9

    def is_recorded(self, topic: str) -> bool:
        """Returns whether the recordings have a topic of this absolute name."""
        return topic in self._channels

    def node(self, name: str, parameters: Mapping[str, Any]) -> RecordedMiddleware:
        """Adds a node.

        Args:
            name: base name, `alert_system`.
            parameters: its configuration, nested as in the file under `ros__parameters`.
        """
        node = RecordedMiddleware(self, self.node_name(name), parameters, self._use_sim_time)
        self._nodes.append(node)
        return node

    def node_name(self, name: str) -> str:
        """Returns the full name of the node with a base name."""
        return f"/{self._namespace}/{name}" if self._namespace else f"/{name}"

    def subscribe(self, subscription: Subscription, type_name: str, field: Optional[str]) -> Subscription:
        """Has a field of every message of a topic delivered; use `RecordedMiddleware.subscribe`.

        A topic that is not recorded delivers nothing.

        Raises:
            ConfigError: the recorded type is another one, has no such field, or has no definition.
        """
        channels = self._channels.get(subscription.topic, [])
        wanted = canonical_type(type_name) if type_name else ""
        matching = [channel for channel in channels if wanted in ("", channel.type_name)]
        if channels and not matching:
            raise ConfigError(
                f"{subscription.topic}: expected messages of type {wanted}, the recording has {channels[0].type_name}"
            )
        for channel in matching:
            self._reader(channel, field).subscriptions.append(subscription)
        return subscription

    def play(self, on_progress: Optional[Callable[[float], None]] = None) -> None:
        """Plays the recordings to their end.

        Args:
            on_progress: called now and then with the fraction that has been played, 0 to 1.
        """
        if self._use_sim_time:
            self._follow_clock()
        report = on_progress or _ignore
        start_ns, end_ns = self._start_ns, self._end_ns
        step_ns = max(1, (end_ns - start_ns) // 1000)
        last_ns = progress_ns = start_ns
        readers = {channel: tuple(of_field.values()) for channel, of_field in self._readers.items()}
        for time_ns, of_channel, data in self._recordings.messages(readers):
            if not start_ns <= time_ns <= end_ns:
                continue
            if time_ns < last_ns:
                self.late += 1
            else:
                last_ns = time_ns
                self._advance(time_ns / 1e9)
                if time_ns >= progress_ns:
                    progress_ns = time_ns + step_ns
                    report((time_ns - start_ns) / max(1, end_ns - start_ns))
            for reader in of_channel:
                self._deliver(reader, data)
        self._advance(max(self.wall_s, end_ns / 1e9))
        report(1.0)

    def _deliver(self, reader: _Reader, data: bytes) -> None:
        try:
            value = reader.get(data)
        except ValueError:
            self.undecodable[reader.topic] = self.undecodable.get(reader.topic, 0) + 1
            return
        if value is ABSENT:
            return
        for subscription in reader.subscriptions:
            subscription.deliver(value)

    def _reader(self, channel: Channel, field: Optional[str]) -> _Reader:
        readers = self._readers.setdefault(channel, {})
        if field not in readers:
            readers[field] = _Reader(channel, field)
        return readers[field]

    def _follow_clock(self) -> None:
        for channel in self._channels[CLOCK]:
            reader = self._reader(channel, "")
            reader.subscriptions[:0] = [_ClockSubscription(node, CLOCK, _ignore_value) for node in self._nodes]

    def _advance(self, now_s: float) -> None:
        """Runs the timers that are due before `now_s`; those due at that instant come after its samples."""
        while self._due_s < now_s:
            self.wall_s = max(self.wall_s, self._due_s)
            for node in self._nodes:
                node.run_steady_timers()
            self._due_s = min((node.next_steady_s() or math.inf for node in self._nodes), default=math.inf)
        self.wall_s = now_s


def _arrival(data: bytes) -> float:
    return 1.0


def _ignore_value(value: Any, now_s: float) -> None:
    """Is not called."""


def _ignore(nothing: object) -> None:
    """Does nothing with a line or a progress."""
