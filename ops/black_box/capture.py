"""Which topics of a robot are recorded, and the subscriptions to them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import partial
from typing import Callable, Collection, Mapping, Sequence

from ...core.config import LINK, MonitorConfig
from ...core.messages import RawFormat
from ...core.port import CLOCK, CLOCK_TYPE, LimitedLog, Middleware, RawMessage, Severity, Subscription
from ...core.values import ConfigError, canonical_type, matches_pattern, printable
from .ring import Message

LARGE_TYPES = frozenset(
    {
        "sensor_msgs/Image",
        "sensor_msgs/CompressedImage",
        "sensor_msgs/PointCloud",
        "sensor_msgs/PointCloud2",
        "stereo_msgs/DisparityImage",
        "theora_image_transport/Packet",
        "ffmpeg_image_transport_msgs/FFMPEGPacket",
        "point_cloud_interfaces/CompressedPointCloud2",
        "foxglove_msgs/CompressedImage",
        "foxglove_msgs/CompressedVideo",
        "foxglove_msgs/PointCloud",
        "foxglove_msgs/RawImage",
        "velodyne_msgs/VelodyneScan",
    }
)
"""Images, videos and clouds: recorded only if the configuration has their topic's full name."""

_MOST_MATCHING = 1_000
"""Topics that patterns select at a time; a robot may list any number, of impossible types."""
_MOST_LINES = 10  # per minute
_LONGEST_SHOWN = 200

_QUIET_S = 1.0  # after the latest message
_LARGEST_QUIET = 64 << 10
_MOST_QUIET = 256 << 10  # bytes of all topics


def is_pattern(topic: str) -> bool:
    """Whether a text stands for several topics."""
    return "*" in topic or "?" in topic


@dataclass(eq=False)
class _Topic:
    """One topic that is wanted: subscribed, or refused, or recorded under another name."""

    name: str
    subscription: Subscription | None = None
    resolved: str = ""
    """The absolute name; empty if it is refused."""
    format: RawFormat | None = None
    """That of the latest message."""
    is_recorded: bool = False
    """Whether messages of this format are recorded."""
    latest: Message | None = None
    """The latest message; None before the first one, and if it is large."""


class Capture:
    """The subscriptions of one robot's black box. Called with the node's lock."""

    def __init__(
        self,
        middleware: Middleware,
        topics: Sequence[str],
        add: Callable[[Message], object],
        own_topics: Collection[str],
    ) -> None:
        """Subscribes to nothing yet.

        Args:
            middleware: the robot's node.
            topics: further topics, by name or pattern.
            add: receives each message.
            own_topics: what the node publishes itself; patterns leave it out.
        """
        self._middleware = middleware
        self._named = [topic for topic in topics if not is_pattern(topic)]
        self._patterns = [topic for topic in topics if is_pattern(topic)]
        self._own = frozenset(own_topics)
        self._add = add
        self.is_simulated = middleware.waiting_for_clock() or abs(middleware.now_s() - middleware.steady_s()) > 1.0
        """Whether the node's time is that of /clock, which may stand still: then messages have steady time."""
        self.topic_types: Mapping[str, str] = {}
        """The types of the robot's topics by name, for the patterns; set by another thread."""
        self._config: MonitorConfig | None = None
        self._followed: Mapping[str, str] | None = None
        self._topics: dict[tuple[str, str], _Topic] = {}
        """By name and type."""
        self._log = LimitedLog(middleware.log, middleware.steady_s, _MOST_LINES)

    @property
    def resolved(self) -> Mapping[str, str]:
        """The absolute name of each topic, by the name in the configuration."""
        return {name: topic.resolved for (name, _), topic in self._topics.items() if topic.resolved}

    def quiet(self, now_s: float) -> list[Message]:
        """Returns the latest message of each topic that is quiet, at a time: of latched topics, and of slow ones.

        A topic is left out if its silence matters to a signal: it may be STALE, or its statistic counts messages.
        """
        messages: list[Message] = []
        left = _MOST_QUIET
        resolved = self.resolved
        known_for_s: dict[str, float] = {}
        """How long the latest message of a topic with signals is as good as repeated; 0 if it counts as an arrival."""
        for signal in {} if self._config is None else self._config.signals.values():
            known_s = (signal.stale_after_s or math.inf) if signal.statistic == "last" else 0.0
            name = resolved.get(signal.topic, "")
            known_for_s[name] = min(known_s, known_for_s.get(name, math.inf))
        for topic in self._topics.values():
            if topic.latest is not None:
                time_s, name, raw_format, data = topic.latest
                if _QUIET_S < now_s - time_s < known_for_s.get(topic.resolved, math.inf) and len(data) <= left:
                    left -= len(data)
                    messages.append((now_s, name, raw_format, data))
        return messages

    def follow(self, config: MonitorConfig) -> None:
        """Subscribes to what is to be recorded by now, and ends the rest. Does nothing if nothing has changed."""
        if config is self._config and self.topic_types == self._followed:
            return
        self._config, self._followed = config, self.topic_types
        types: dict[str, str] = {}
        for name, signal in config.signals.items():
            if name != LINK and canonical_type(signal.type) not in LARGE_TYPES:
                types[signal.topic] = types.get(signal.topic) or signal.type
        if self.is_simulated:
            types[CLOCK] = CLOCK_TYPE
        matching = (
            each
            for each in sorted(self._followed.items())
            if each[0] not in self._own
            and canonical_type(each[1]) not in LARGE_TYPES
            and any(matches_pattern(each[0], pattern) for pattern in self._patterns)
        )
        names = ((name, "") for name in self._named)
        wanted = dict.fromkeys((*types.items(), *names, *itertools.islice(matching, _MOST_MATCHING)))
        known, self._topics = self._topics, {}
        for key, topic in known.items():
            if key not in wanted:
                self._end(topic)
            elif topic.subscription is not None or not topic.resolved:  # else it is recorded under another name
                self._topics[key] = topic
        for key in wanted:
            if key not in self._topics:
                self._topics[key] = self._subscribe(key)

    def close(self) -> None:
        """Ends all subscriptions."""
        for topic in self._topics.values():
            self._end(topic)
        self._topics = {}

    def _subscribe(self, key: tuple[str, str]) -> _Topic:
        topic = _Topic(key[0])
        try:
            subscription = self._middleware.subscribe_raw(*key, partial(self._take, topic))
        except ConfigError as error:
            text = f"black box: {key[0][:_LONGEST_SHOWN]} is not recorded: {error.problem}"
            self._log.write("", Severity.WARN, printable(text))
            return topic
        if subscription.topic in self.resolved.values():  # by another name
            self._middleware.unsubscribe(subscription)
        else:
            topic.subscription = subscription
        topic.resolved = subscription.topic
        return topic

    def _take(self, topic: _Topic, message: RawMessage, now_s: float) -> None:
        data, raw_format = message
        name = topic.resolved or topic.name
        if raw_format is not topic.format or not topic.is_recorded:
            topic.format = raw_format
            topic.is_recorded = name in self._named or canonical_type(raw_format.schema_name) not in LARGE_TYPES
        if topic.is_recorded:
            taken = self._middleware.steady_s() if self.is_simulated else now_s, name, raw_format, data
            topic.latest = taken if len(data) <= _LARGEST_QUIET else None
            self._add(taken)

    def _end(self, topic: _Topic) -> None:
        if topic.subscription is not None:
            self._middleware.unsubscribe(topic.subscription)
