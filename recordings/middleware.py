"""The port over recordings: messages and time come from files.

A `Player` reads recordings once and delivers each message to its nodes at its log time. Timers run in between, at
their own periods, so that a node decides as it would have decided live. Time ends with the recording: its end is not
silence. Everything runs in the thread that calls `play`.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import chain
from typing import Any, Callable, Iterable, Iterator, Mapping

from ..core.port import CLOCK, Answer, Callback, ClockTimer, LocalBus, LocalMiddleware, LogLine, MappingNode
from ..core.values import ABSENT, ConfigError, JsonObject, canonical_type, count_text, full_name, list_text
from .decoding import type_of
from .reading import Recordings
from .recording import Channel, RecordingError

_LONGEST_SILENCE_S = 86_400.0
"""Timers run through a gap of this length; the rest of a longer one is skipped. One message with a damaged time would
otherwise ask for the ticks of centuries."""


_Getter = Callable[[bytes], Any]
_Delivery = Callable[[bytes, float], None]


class Subscription:
    """A node's subscription to a recorded topic; implements `core.port.Subscription`."""

    def __init__(self, node: LocalMiddleware, topic: str, callback: Callback) -> None:
        """Binds a callback of a node to a topic."""
        self.node = node
        self.topic = topic
        self.callback = callback
        self.active = True


class RecordedMiddleware(LocalMiddleware):
    """One node that receives recorded messages; implements `core.port.Middleware`.

    Its publications have no listeners, its services have no callers, and `subscribe_raw` receives nothing: a recording
    is not recorded again.
    """

    knows_graph = False
    follow_graph = MappingNode.follow_graph  # type: ignore[assignment]

    def __init__(self, player: Player, name: str, parameters: JsonObject) -> None:
        """Use `Player.node`."""
        super().__init__(player.bus, name, parameters, {}, player.use_sim_time)
        self.player = player
        if player.use_sim_time:
            self._clock_subscription = Subscription(self, CLOCK, self.take_clock)
            player.subscribe(self._clock_subscription, "", "")

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        timer = super().create_timer(period_s, callback, steady=steady)
        self.player.due_s = min(self.player.due_s, timer.due_s)
        return timer

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> Any:
        subscription = Subscription(self, self.resolve(topic), callback)
        self._subscriptions.append(subscription)
        self.player.subscribe(subscription, type_name, field)
        return subscription

    def topic_types(self) -> Mapping[str, str]:
        return self.player.topic_types()

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        answer(self.player.why_not_recorded(topic, type_name) or None)

    def unsubscribe(self, subscription: Any) -> None:
        subscription.active = False


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
        begin_ns: int | None = None,
        on_log: Callable[[LogLine], None] | None = None,
    ) -> None:
        """Prepares to play, from one time to another, in s since the start of the recordings; time stands at the first.

        `begin_ns` is a time before the first message with which to begin instead, in ns since 1970.

        The nodes will be in `namespace`, and log to `on_log`. With `use_sim_time` their time is that of the recorded
        topic /clock. Raises ConfigError if it is not recorded.
        """
        self._recordings = recordings
        self._namespace = namespace
        span = recordings.span_ns or (0, 0)
        self._start_ns = min(begin_ns or span[0], span[0]) + round(from_s * 1e9)
        self._end_ns = min(span[1], span[0] + round(to_s * 1e9)) if to_s < math.inf else span[1]
        self.end_s = self._end_ns / 1e9  # log time at which playing ends, since 1970
        self.use_sim_time = use_sim_time
        self.wall_s = self._start_ns / 1e9  # log time of the current message, since 1970
        self.late = 0  # messages that came out of the order of their log times and were delivered late
        self._undecodable: Counter[Subscription] = Counter()
        """The messages from which the field of a subscription could not be read."""
        self._outside = 0
        self._skipped_s = 0.0
        self.bus = LocalBus(on_log=on_log or _ignore, clock=lambda: self.wall_s)
        self.on_gap: list[Callable[[float, float], None]] = []
        """Called with begin and end, in seconds, of each time that is skipped: timers do not run in it."""
        self._gaps_ns: list[tuple[int, int]] = []
        self.due_s = math.inf  # when the next timer of a node is due; may be too early, never too late
        self._channels: dict[str, list[Channel]] = {}
        for channel in recordings.channels:
            self._channels.setdefault(channel.topic, []).append(channel)
        self._readers: dict[Channel, list[tuple[_Getter, Subscription]]] = {}
        """What reads a message of a channel, and who receives that, in the order of the subscriptions."""
        self._firsts: dict[tuple[Channel, ...], tuple[Channel, bytes] | None] = {}
        """The first message of the channels of a topic, as far as it was needed; None if there is none."""
        if use_sim_time and not self._channels.get(CLOCK):
            raise ConfigError("simulated time was requested, but the recordings have no topic /clock")

    @property
    def problems(self) -> list[str]:
        """One line for each thing that was not read, or not as it was recorded, until now."""
        lines = self._recordings.problems
        undecodable = sorted((each.topic, number) for each, number in self._undecodable.items())
        for topic, number in dict(undecodable).items():  # the largest number: a message may lack several fields
            lines.append(f"{topic}: {_left_out(number, 'could not be decoded and')}")
        if self._outside:
            lines.append(_left_out(self._outside, "outside of the time span"))
        if self.late:
            lines.append(f"{count_text(self.late, 'message')} out of order, judged late")
        if self._skipped_s:
            lines.append(f"no messages for more than {_LONGEST_SILENCE_S / 3600:g} h: {self._skipped_s:.0f} s skipped")
        return lines

    def why_not_recorded(self, topic: str, type_name: str) -> str:
        """Returns why a topic, by its absolute name, is not recorded with a type, or with any; empty if it is."""
        channels = self._channels.get(topic, [])
        if not channels:
            return f"{topic} is not recorded"
        if not self._matching(topic, type_name):
            return f"{topic} is recorded as {channels[0].type_name}, configured as {canonical_type(type_name)}"
        return ""

    def why_unreadable(self, topic: str, type_name: str, field: str | None) -> str:
        """Returns why no message of a topic can be read with a field, or its arrival if that is None.

        Empty if one can, if there is none, or if the recorded type has no such field.
        """
        channels = tuple(self._matching(topic, type_name))
        try:
            getters = {channel: _getter(channel, field) for channel in channels}
        except ConfigError:  # raised with its place in the configuration when the topic is subscribed
            return ""
        if channels not in self._firsts:
            self._firsts[channels] = next(self._messages_of(channels), None)
        first = self._firsts[channels]
        if first is None:
            return f"{topic} is in damaged parts only" if self._recordings.have_holes(channels) else ""
        messages = chain([first], self._messages_of(channels))
        is_readable = any(_can_read(getters[channel], data) for channel, data in messages)
        return "" if is_readable else f"no message on {topic} can be decoded"

    def _messages_of(self, channels: Iterable[Channel]) -> Iterator[tuple[Channel, bytes]]:
        return ((channel, data) for _, channel, data in self._recordings.messages({each: each for each in channels}))

    def topic_types(self) -> Mapping[str, str]:
        """Returns the type of every recorded topic."""
        return {topic: channels[0].type_name for topic, channels in self._channels.items()}

    def node(self, name: str, parameters: JsonObject) -> RecordedMiddleware:
        """Adds a node with a base name, `alert_system`, and parameters as in the file under `ros__parameters`."""
        node = RecordedMiddleware(self, self.node_name(name), parameters)
        self.bus.nodes.append(node)
        return node

    def node_name(self, name: str) -> str:
        """Returns the full name of the node with a base name."""
        return full_name(name, self._namespace)

    def subscribe(self, subscription: Subscription, type_name: str, field: str | None) -> None:
        """Delivers a field of every message of a topic; use `RecordedMiddleware.subscribe`.

        A topic that is not recorded, or with another type only, delivers nothing: see `why_not_recorded`. Raises
        ConfigError if the recorded type has no such field, or no definition.
        """
        for channel in self._matching(subscription.topic, type_name):
            self._readers.setdefault(channel, []).append((_getter(channel, field), subscription))

    def play(self, on_progress: Callable[[float], None] | None = None) -> None:
        """Plays the recordings to their end. Subscriptions must exist before.

        `on_progress` is called about a thousand times with the fraction that has been played, 0 to 1; it may raise.
        Raises RecordingError at once if a recording has messages of the subscribed topics, but none that can be read.
        """
        self._require_readable()
        report = on_progress or _ignore
        start_ns, end_ns = self._start_ns, self._end_ns
        step_ns = max(1, (end_ns - start_ns) // 1000)
        last_ns = progress_ns = start_ns
        now_s = self.wall_s
        first_ns, past_ns = self._recordings.span_ns or (0, 0)
        if not self.use_sim_time:
            self._gaps_ns = [gap for gap in self._recordings.gaps_ns if start_ns < gap[0] and gap[1] <= end_ns]
        deliveries = {
            channel: tuple(self._delivery(*reader) for reader in readers) for channel, readers in self._readers.items()
        }
        for time_ns, of_channel, data in self._recordings.messages(deliveries):
            if not start_ns <= time_ns <= end_ns:
                self._outside += not first_ns <= time_ns <= past_ns
                continue
            if time_ns > last_ns:
                last_ns = time_ns
                now_s = time_ns / 1e9
                if self._gaps_ns and self._gaps_ns[0][1] <= time_ns:
                    self._cross_gaps(time_ns)
                if self.due_s < now_s:
                    self._run_timers(now_s)
                self.wall_s = now_s
                if time_ns >= progress_ns:
                    progress_ns = time_ns + step_ns
                    report((time_ns - start_ns) / (end_ns - start_ns))
            elif time_ns < last_ns:
                self.late += 1
            for deliver in of_channel:
                deliver(data, now_s)
        # A damaged recording may have ended before the time that its index gives: the rest is not silence.
        _, read_ns = self._recordings.span_ns or (0, 0)
        self._cross_gaps(min(end_ns, read_ns))
        end_s = max(self.wall_s, min(end_ns, read_ns) / 1e9)
        self._run_timers(end_s)
        if self.due_s == end_s:
            self._run_due(end_s)
        self.wall_s = end_s
        report(1.0)

    def _matching(self, topic: str, type_name: str) -> list[Channel]:
        wanted = canonical_type(type_name) if type_name else ""
        return [channel for channel in self._channels.get(topic, []) if wanted in ("", channel.type_name)]

    def _delivery(self, get: _Getter, subscription: Subscription) -> _Delivery:
        """Returns a function that passes on what a getter reads from a serialized message, with its log time in s."""
        undecodable, simulated = self._undecodable, self.use_sim_time
        node, callback = subscription.node, subscription.callback

        def deliver(data: bytes, wall_s: float) -> None:
            if subscription.active:
                try:
                    value = get(data)
                except ValueError:
                    undecodable[subscription] += 1
                    value = ABSENT  # a sign of life
                if simulated:
                    node.call_back(subscription, value)
                    return
                try:
                    callback(value, wall_s)
                except Exception as error:
                    node.log_failure(error)

        return deliver

    def _require_readable(self) -> None:
        """Raises RecordingError if a recording has messages of the subscribed topics, but none that can be read."""
        channels = {channel: channel for channel in self._readers}
        for number, path in enumerate(self._recordings.paths):
            undecodable = set()
            for _, channel, data in self._recordings.messages(channels, number):
                if any(_can_read(get, data) for get, _ in self._readers[channel]):
                    break
                undecodable.add(channel.topic)
            else:
                problem = f"none of its messages on {list_text(sorted(undecodable))} can be decoded"
                problem = problem if undecodable else self._recordings.problem_without(number, channels)
                if problem:
                    raise RecordingError(problem, file=path)

    def _cross_gaps(self, until_ns: int) -> None:
        """Goes from the end of a recording to the start of the next one, without the timers in between."""
        while self._gaps_ns and self._gaps_ns[0][1] <= until_ns:
            begin_ns, end_ns = self._gaps_ns.pop(0)
            self._run_timers(begin_ns / 1e9)
            self._skip(begin_ns / 1e9, end_ns / 1e9)

    def _run_timers(self, before_s: float) -> None:
        """Runs the timers that are due before a time; those due at that instant come after its samples."""
        stop_s = self.wall_s + _LONGEST_SILENCE_S
        while self.due_s < before_s:
            if self.due_s > stop_s:
                self._skipped_s += before_s - self.due_s
                if not self.use_sim_time:
                    self._skip(self.due_s, before_s)
                self.due_s = before_s
            self._run_due(max(self.wall_s, self.due_s))

    def _skip(self, begin_s: float, end_s: float) -> None:
        self.wall_s = end_s
        for callback in self.on_gap:
            callback(begin_s, end_s)

    def _run_due(self, now_s: float) -> None:
        self.wall_s = now_s
        self.bus.run_due(now_s)
        self.due_s = min((node.next_steady_s() for node in self.bus.nodes), default=math.inf)


def _left_out(messages: int, why: str) -> str:
    return f"{count_text(messages, 'message')} {why} {'was' if messages == 1 else 'were'} left out"


def _getter(channel: Channel, field: str | None) -> _Getter:
    return (lambda data: 1.0) if field is None else type_of(channel).field_getter(field)


def _can_read(get: Callable[[bytes], Any], data: bytes) -> bool:
    try:
        get(data)
    except ValueError:
        return False
    return True


def _ignore(nothing: object) -> None:
    """Does nothing with a line or a progress."""
