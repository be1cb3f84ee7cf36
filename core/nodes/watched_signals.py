"""Which signals are watched, and what brings their samples: topics, actions, or the robot's graph of nodes."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import Any, Callable, Mapping, Optional, Tuple

from ..config import DEFAULT_SIGNALS, LINK, MonitorConfig, SignalConfig, causes_of, load_config
from ..judge import Monitor
from ..port import Counts, Middleware, Subscription, Timer, Unread, Wanted
from ..values import ABSENT, ConfigError, Goals, JsonObject, ServiceError, resolve_name

_MAX_LIST = 10_000  # characters
_ACTION_TOPIC = re.compile(r"(/_action)?/status\Z")
"""What is behind the name of an action in that of its topic of states, on ROS 2 and on ROS 1."""
_NO_SENSOR = "battery_sensor reports that its host has no such sensor"

_Source = Tuple[str, str, str, Optional[str]]
"""Where a signal comes from: its name, topic, type, and what is read of its messages."""


class WatchedSignals:
    """Subscribes to what the signals of a configuration need, and passes their values on."""

    def __init__(
        self,
        middleware: Middleware,
        monitor: Monitor,
        take: Callable[[str, Any, float], None],
        note_change: Callable[[str, float], None],
        apply: Callable[[MonitorConfig, float], None],
    ) -> None:
        """Subscribes to nothing yet.

        Args:
            middleware: the node's connection.
            monitor: judges the signals; all of its configuration is watched until `change_to`.
            take: receives a signal's name, a value (or `ABSENT`: a message without one) and the time in s.
            note_change: receives a text when a signal begins or ceases to be watched, and the time in s.
            apply: then receives the configuration with the signals that are watched.
        """
        self._middleware, self._monitor = middleware, monitor
        self._take, self._note_change, self._apply = take, note_change, apply
        self.config = monitor.config
        """The configuration in force, with the signals that are left out."""
        self.left_out: Mapping[str, str] = {}
        """Why signals are not watched, by name: nothing brings samples for them."""
        self._unknown: Mapping[str, str] = {}
        """Why signals of the graph cannot be watched here, by name."""
        self._unread = ""
        """Why none of the others can, as long as the graph has never been read; empty once it has."""
        self.without_sensor: set[str] = set()
        """The signals for which this host has no sensor."""
        self.topics: Mapping[str, str] = {}
        """The resolved topic of each signal; of an action, which has two, the resolved name."""
        self._subscriptions: dict[_Source, Subscription] = {}
        self._of_graph: Mapping[str, Wanted] = {}
        """What each signal of the robot's graph counts."""
        self._graph_timer: Timer | None = None
        self._simulated_topics = ""
        self._simulated: frozenset[str] = frozenset()

    def follow(self, config: MonitorConfig, unknown: Mapping[str, str]) -> None:
        """Subscribes to new topics, then ends old subscriptions; one that is refused is a ConfigError and no change.

        `unknown` are the signals of the graph that cannot be watched here, as from `read_config`.
        """
        wanted = {
            (name, topic, signal.type, signal.selection)
            for name, signal in config.signals.items()
            if name != LINK
            for topic in signal.topics
        }
        added: dict[_Source, Subscription] = {}
        # Signals with a type and a field first: those that only count messages can share their subscription. Of one
        # message, they are handed over in this order: causes first.
        order = causes_of(config.signals).first(config.signals)
        new = wanted - self._subscriptions.keys()
        for source in sorted(new, key=lambda key: (key[3] is None, key[2] == "", order.index(key[0]))):
            try:
                added[source] = self._subscribe(source, config.signals[source[0]])
            except ConfigError as error:
                for subscription in added.values():
                    self._middleware.unsubscribe(subscription)
                raise ConfigError(error.problem, ("signals", source[0])) from None
        for source in self._subscriptions.keys() - wanted:
            self._middleware.unsubscribe(self._subscriptions.pop(source))
        self._subscriptions.update(added)
        self.topics = {
            name: _ACTION_TOPIC.sub("", subscription.topic) if config.signals[name].action else subscription.topic
            for (name, *_), subscription in self._subscriptions.items()
        }
        self._monitor.expect_sources({config.signals[name].topic: topic for name, topic in self.topics.items()})
        self._simulated = frozenset(self._signals_on(self._simulated_topics))
        counted = {name: signal.graph for name, signal in config.signals.items() if name not in unknown}
        self._of_graph = {name: graph for name, graph in counted.items() if graph is not None}
        if self._of_graph and self._graph_timer is None:
            self._graph_timer = self._middleware.follow_graph(lambda: set(self._of_graph.values()), self._take_counts)
        elif not self._of_graph and self._graph_timer is not None:
            self._graph_timer.cancel()
            self._graph_timer = None

    def change_to(self, config: MonitorConfig, unknown: Mapping[str, str], now_s: float) -> None:
        """Watches another configuration, after `follow`, which gets the same `unknown`."""
        old, self.config, self._unknown = self.config.signals, config, unknown
        self.without_sensor = {name for name in self.without_sensor if config.signals.get(name) == old[name]}
        self._update(now_s)

    def take_in(self, name: str, now_s: float) -> None:
        """Watches a signal that was left out: a sample came."""
        self.without_sensor.discard(name)
        self._update(now_s)

    def note_unavailable(self, metrics: Any, now_s: float) -> None:
        """Applies the list from battery_sensor: signals that no sensor will ever publish are not watched."""
        signals = self._signals_on(metrics)
        # A signal that has had a sample has a sensor: its silence is an alert.
        new = signals - self.without_sensor
        judgements = self._monitor.judgements(now_s) if new else {}
        self.without_sensor = signals - {name for name in new if name in judgements and judgements[name].seen}
        self._update(now_s)

    def _update(self, now_s: float) -> None:
        """Names each signal that is now left out, or watched again, and applies a configuration that differs."""
        before = self.left_out
        unread = dict.fromkeys(self._of_graph, self._unread) if self._unread else {}
        self.left_out = {**self._unknown, **unread, **dict.fromkeys(self.without_sensor, _NO_SENSOR)}
        for name in sorted(self.left_out.keys() ^ before.keys()):
            is_watched = "watched again" if name in before else f"not watched: {self.left_out[name]}"
            self._note_change(f"{name} is {is_watched}", now_s)
        signals = {name: signal for name, signal in self.config.signals.items() if name not in self.left_out}
        watched = replace(self.config, signals=signals)
        if watched != self._monitor.config:
            self._apply(watched, now_s)

    def note_simulated(self, topics: Any, now_s: float) -> None:
        """Applies the list from battery_sensor, which comes every second."""
        if topics != self._simulated_topics:
            self._simulated_topics = topics
            self._simulated = frozenset(self._signals_on(topics))

    def is_simulated(self, signal: str) -> bool:
        """Returns whether battery_sensor invents the values of a signal or source. May be called in any thread."""
        # All elements of an array are of one topic.
        return signal.partition("[")[0] in self._simulated or signal in map(self.topics.get, self._simulated)

    def look_up_hints(self, now_s: float) -> None:
        """Looks up why signals have no samples, before they are announced as STALE."""
        for config in self._monitor.without_samples(now_s):
            hint = self._middleware.why_silent(config.topics[0], config.type)
            self._monitor.note_hint(config.name, hint or "")

    def _subscribe(self, source: _Source, signal: SignalConfig) -> Subscription:
        name, topic, type_name, field = source
        take = partial(self._take, name)
        if not signal.action:
            # Frames that never move are published once.
            latched = topic.rpartition("/")[2] == "tf_static"
            return self._middleware.subscribe(topic, type_name, take, field=field, latched=latched)
        goals = Goals()

        def take_goals(message: Any, now_s: float) -> None:
            for value in goals.take(message) or (ABSENT,):
                take(value, now_s)

        # The last message says which goals had ended before.
        return self._middleware.subscribe(topic, type_name, take_goals, latched=True)

    def _take_counts(self, counts: Counts | Unread, now_s: float) -> None:
        """Passes on what was counted in the robot's graph, or notes why it cannot be read."""
        self._unread = counts.reason if isinstance(counts, Unread) and not counts.is_watched else ""
        self._update(now_s)
        for name, wanted in self._of_graph.items():
            if isinstance(counts, Unread):
                self._monitor.note_hint(name, counts.reason)
            elif wanted in counts:
                self._take(name, counts[wanted], now_s)

    def _signals_on(self, names: Any) -> set[str]:
        """Returns the signals on the topics of a list from battery_sensor."""
        given = [name.strip() for name in str(names)[:_MAX_LIST].split(",")]
        topics = {resolve_name(name, self._middleware.name) for name in given if name}
        return {name for name, topic in tuple(self.topics.items()) if topic in topics}


def read_config(
    middleware: Middleware, tree: JsonObject, *, adds_defaults: bool
) -> tuple[MonitorConfig, Mapping[str, str]]:
    """Reads the configuration in a tree, and why signals of the robot's graph cannot be watched here.

    With `adds_defaults`, the tree has changes of the default signals. Raises ConfigError.
    """
    signals = tree.get("signals", {})
    if adds_defaults and isinstance(signals, Mapping):
        merged = {
            name: {**DEFAULT_SIGNALS.get(name, {}), **given} if isinstance(given, Mapping) else given
            for name, given in signals.items()
        }
        tree = {**tree, "signals": {**DEFAULT_SIGNALS, **merged}}
    config = load_config(tree)
    resolved: dict[str, SignalConfig] = {}
    unknown: dict[str, str] = {}
    for name, signal in config.signals.items():
        if signal.graph is not None:
            key, graph_name = signal.graph
            try:
                changed: JsonObject = {key: middleware.graph_name(key, graph_name)}
                resolved[name] = replace(signal, **changed)
            except ServiceError as error:
                unknown[name] = str(error)
            except ConfigError as error:
                raise ConfigError(error.problem, ("signals", name, key)) from None
    return replace(config, signals={**config.signals, **resolved}), unknown
