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
from robot_health_monitor.core.local import LocalBus, LocalMiddleware, LogLine

from .decoding import types_of
from .reading import Recordings
from .recording import Channel, canonical_type

CLOCK = "/clock"
CLOCK_FIELD = "clock"

Callback = Callable[[Any, float], None]


class Subscription:
    """A node's subscription to a recorded topic."""

    def __init__(self, topic: str, field: Optional[str], callback: Callback) -> None:
        """Stores what is delivered to whom.

        Args:
            topic: the absolute name.
            field: path of the field to read; None: arrivals only.
            callback: called with value and time.
        """
        self.topic = topic
        self.field = field
        self.callback = callback
        self.active = True


class _Reader:
    """One field of one channel: read once per message, delivered to every subscription."""

    def __init__(self, channel: Channel, field: Optional[str]) -> None:
        self.get: Callable[[bytes], Any] = _arrival if field is None else types_of(channel).field_getter(field)
        self.topic = channel.topic
        self.subscriptions: List[Subscription] = []


class RecordedMiddleware(LocalMiddleware):
    """One node that receives recorded messages; implements `core.middleware.Middleware`.

    Topics that it publishes on and services that it offers stay in this process.
    """

    def __init__(self, player: Player, name: str, parameters: Mapping[str, Any]) -> None:
        """Use `Player.node`."""
        super().__init__(player.bus, name, parameters, {})
        self._player = player

    def waiting_for_clock(self) -> bool:
        """Returns True under simulated time before the first message on /clock."""
        return self._player.waiting_for_clock

    def subscribe(  # type: ignore[override]  # its own kind of subscription
        self, topic: str, type_name: str, callback: Callback, *, field: Optional[str] = ""
    ) -> Subscription:
        """Receives a recorded topic; see `core.middleware.Middleware.subscribe`.

        A topic that is not recorded delivers nothing.

        Raises:
            ConfigError: the recorded type is another one, has no such field, or has no definition.
        """
        return self._player.subscribe(self._resolve(topic), type_name, field, callback)

    def unsubscribe(self, subscription: Any) -> None:
        """Ends a subscription."""
        if isinstance(subscription, Subscription):
            subscription.active = False
        else:
            super().unsubscribe(subscription)


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
        self.waiting_for_clock = use_sim_time
        """Whether simulated time has not begun."""
        self.wall_s = self._start_ns / 1e9
        """Log time of the message that is being played, in seconds since 1970."""
        self.late = 0
        """How many messages came out of the order of their log times; they were delivered late."""
        self.undecodable: Dict[str, int] = {}
        """How many messages of a topic did not match its type."""
        self.bus = LocalBus(0.0 if use_sim_time else self.wall_s, on_log)
        """Virtual time and timers of the nodes."""
        self._channels: Dict[str, List[Channel]] = {}
        for channel in recordings.channels:
            self._channels.setdefault(channel.topic, []).append(channel)
        self._readers: Dict[Channel, Dict[Optional[str], _Reader]] = {}
        if use_sim_time and not self._channels.get(CLOCK):
            raise ConfigError("simulated time was requested, but the recordings have no topic /clock")

    def is_recorded(self, topic: str) -> bool:
        """Returns whether the recordings have a topic of this absolute name."""
        return topic in self._channels

    def node(self, name: str, parameters: Mapping[str, Any]) -> RecordedMiddleware:
        """Adds a node.

        Args:
            name: base name, `alert_system`.
            parameters: its configuration, nested as in the file under `ros__parameters`.
        """
        full_name = f"/{self._namespace}/{name}" if self._namespace else f"/{name}"
        node = RecordedMiddleware(self, full_name, parameters)
        self.bus.nodes.append(node)
        return node

    def subscribe(self, topic: str, type_name: str, field: Optional[str], callback: Callback) -> Subscription:
        """Has a field of every message of a topic delivered; use `RecordedMiddleware.subscribe`.

        Raises:
            ConfigError: as there.
        """
        channels = self._channels.get(topic, [])
        wanted = canonical_type(type_name) if type_name else ""
        matching = [channel for channel in channels if wanted in ("", channel.type_name)]
        if channels and not matching:
            raise ConfigError(f"{topic}: expected messages of type {wanted}, the recording has {channels[0].type_name}")
        subscription = Subscription(topic, field, callback)
        for channel in matching:
            readers = self._readers.setdefault(channel, {})
            if field not in readers:
                readers[field] = _Reader(channel, field)
            readers[field].subscriptions.append(subscription)
        return subscription

    def play(self, on_progress: Optional[Callable[[float], None]] = None) -> None:
        """Plays the recordings to their end.

        Args:
            on_progress: called now and then with the fraction that has been played, 0 to 1.
        """
        if self._use_sim_time:
            self._follow_clock()
        report = on_progress or _ignore
        follows_log_time = not self._use_sim_time
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
                self.wall_s = time_ns / 1e9
                if follows_log_time:
                    self._advance(self.wall_s)
                if time_ns >= progress_ns:
                    progress_ns = time_ns + step_ns
                    report((time_ns - start_ns) / max(1, end_ns - start_ns))
            for reader in of_channel:
                self._deliver(reader, data)
        self.wall_s = max(self.wall_s, end_ns / 1e9)
        if follows_log_time:
            self._advance(self.wall_s)
        report(1.0)

    def _deliver(self, reader: _Reader, data: bytes) -> None:
        try:
            value = reader.get(data)
        except ValueError:
            self.undecodable[reader.topic] = self.undecodable.get(reader.topic, 0) + 1
            return
        if value is ABSENT or (self.waiting_for_clock and reader.topic != CLOCK):
            return
        now_s = self.bus.now_s
        for subscription in reader.subscriptions:
            if subscription.active:
                subscription.callback(value, now_s)

    def _follow_clock(self) -> None:
        for channel in self._channels[CLOCK]:
            readers = self._readers.setdefault(channel, {})
            if CLOCK_FIELD not in readers:
                readers[CLOCK_FIELD] = _Reader(channel, CLOCK_FIELD)
            readers[CLOCK_FIELD].subscriptions.insert(0, Subscription(CLOCK, CLOCK_FIELD, self._take_clock))

    def _advance(self, now_s: float) -> None:
        """Runs the timers that are due before `now_s`; those due at that instant come after its samples."""
        bus = self.bus
        due_s = bus.next_due_s()
        while due_s is not None and due_s < now_s:
            bus.run_due(due_s)
            due_s = bus.next_due_s()
        bus.now_s = now_s

    def _take_clock(self, stamp: Any, now_s: float) -> None:
        seconds = getattr(stamp, "sec", None)
        nanoseconds = getattr(stamp, "nanosec", None)
        if isinstance(stamp, Mapping):
            seconds, nanoseconds = stamp.get("sec"), stamp.get("nanosec")
        if not isinstance(seconds, int) or not isinstance(nanoseconds, int):
            return
        time_s = seconds + nanoseconds / 1e9
        if self.waiting_for_clock:
            self.waiting_for_clock = False
            self.bus.run_due(time_s)
        elif time_s < self.bus.now_s:
            self.bus.run_due(time_s)
        else:
            self._advance(time_s)


def _arrival(data: bytes) -> float:
    return 1.0


def _ignore(fraction: float) -> None:
    """Does nothing with a progress."""
