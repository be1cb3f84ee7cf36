"""The nodes of a live robot: those that publish what is watched, and lifecycle nodes that are active."""

from __future__ import annotations

import re
from typing import Mapping, Sequence

from ..config import ACTIVE, is_element_name, template_name
from ..port import Counts, Middleware, NodeInfo, Unread, Wanted
from ..values import ConfigError, ServiceError, list_text
from .candidates import Candidates, relative
from .proposal import PUBLISHED_HERE, Proposed
from .suggestion import Setting, Signal

_GET_STATE = "/get_state"
"""Ending of the service that every lifecycle node has."""
_AFTER_S = 2.0
"""How much later than the silence of its topics a node is an alert, in s: there is one alert, that of the silence."""
_TOOLS = re.compile(
    r".*/(_[^/]*|rosout|(rosbag2?|rostopic|launch_ros|rosbridge|foxglove_bridge|rqt|rviz2?|plotjuggler)(_[^/]*)?|[^/]*_\d{5,})\Z",
    re.ASCII | re.IGNORECASE,
)
"""Names of tools, bridges and hidden nodes, and anonymous names, which end with the number of a process or a time."""


class Nodes:
    """Counts nodes by the same code as the monitor, while the robot is listened to."""

    def __init__(self) -> None:
        """Knows no node."""
        self.problem = ""
        """Why the graph is not known; empty if it is."""
        self._publishers: dict[str, set[str]] = {}
        """Names of the nodes that publish each topic."""
        self._has_lifecycle = True
        self._seen: dict[Wanted, set[float]] = {}
        """The numbers of each node that were counted; of lifecycle nodes their states."""

    def begin(self, node: Middleware) -> None:
        """Begins to count what `take` adds, if the middleware knows the graph."""
        try:
            node.graph_name("node", "any")
            node.follow_graph(lambda: tuple(self._seen), self._note)
            node.graph_name("lifecycle", "any")
        except ConfigError:
            self._has_lifecycle = False
        except ServiceError as error:
            self.problem = str(error)

    def take(self, nodes: Mapping[str, NodeInfo]) -> None:
        """Adds the nodes of one reading of the graph."""
        for name, info in nodes.items():
            for topic in info.publishes:
                self._publishers.setdefault(topic, set()).add(name)
            self._seen.setdefault(("node", name), set())
            if self._has_lifecycle and name + _GET_STATE in info.services:
                self._seen.setdefault(("lifecycle", name), set())

    def add_to(self, proposed: Proposed, candidates: Candidates) -> None:
        """Adds the nodes to what is proposed, and what depends on what where the names make that certain."""
        own = {node for topic in candidates.own_topics for node in self._publishers.get(topic, ())}
        watched: dict[str, list[Signal]] = {}
        for signal in tuple(proposed.signals):
            if signal.kind == "log":  # which every node publishes
                if not self.problem and all(map(_TOOLS.match, self._publishers.get(signal.topic, own) - own)):
                    proposed.signals.remove(signal)
                    proposed.not_watched[signal.topic] = PUBLISHED_HERE
            elif not signal.is_shown_only:
                watched.setdefault(signal.topic, []).append(signal)
        statuses = self._statuses(candidates)
        others: list[str] = []
        for node in sorted(name for key, name in self._seen if key == "node" and name not in own):
            published = [topic for topic in watched if node in self._publishers.get(topic, ())]
            alone = {topic: watched[topic] for topic in published if len(self._publishers[topic]) == 1}
            for signal in [signal for signals in alone.values() for signal in signals]:
                _depend_on_driver(signal, statuses.get(node, []))
            key = "lifecycle" if ("lifecycle", node) in self._seen else "node"
            reason = self._why_not(key, node)
            if not published and (reason or key == "node"):
                others += [] if _TOOLS.match(node) else [node]
            elif reason:
                proposed.not_watched[f"{key} {node}"] = reason
            else:
                short = relative(node, candidates.namespace)
                signal = Signal(candidates.names.of(short, key), f"{key} {node}", "node", {key: short})
                signal.note = (
                    f"publishes {list_text(published, most=5)}" if published else "a lifecycle node that is active"
                )
                if key == "node":
                    _depend_on_topics(signal, alone)
                proposed.signals.append(signal)
        if others:
            proposed.not_watched["nodes"] = f"{list_text(others, most=50)} publish nothing that is watched"
        if self.problem:
            proposed.not_watched["nodes"] = self.problem

    def _statuses(self, candidates: Candidates) -> Mapping[str, list[str]]:
        """Returns the signals of the statuses of each node, by whose name they begin: `laser: scan` of `/laser`."""
        statuses: dict[str, list[str]] = {}
        for template, status in candidates.statuses:
            driver = status.partition(":")[0].strip().lstrip("/")
            nodes = {node for _, node in self._seen if driver in (node.lstrip("/"), node.rpartition("/")[2])}
            name = f"{template}[{status}]"
            if len(nodes) == 1 and is_element_name(name):
                statuses.setdefault(nodes.pop(), []).append(name)
        return statuses

    def _why_not(self, key: str, name: str) -> str:
        """Returns why a node, or the state of a lifecycle node, is not watched; empty if it is."""
        seen = self._seen[key, name]
        if _TOOLS.match(name):
            return "a tool, or an anonymous node: these come and go"
        if not seen:
            return "seen too late to be counted"
        if key == "node":
            return "" if min(seen) >= 1.0 else "not there all the time"
        return "" if seen == {ACTIVE} else "not active all the time"

    def _note(self, numbers: Counts | Unread, now_s: float) -> None:
        if isinstance(numbers, Unread):
            self.problem = "" if any(self._seen.values()) else numbers.reason
            return
        self.problem = ""
        for wanted, number in numbers.items():
            self._seen[wanted].add(number)


def _depend_on_driver(signal: Signal, statuses: Sequence[str]) -> None:
    """Lets a signal depend on the status of its driver; of several, which one is a guess."""
    if not statuses or signal.name in map(template_name, statuses):
        return
    if len(statuses) == 1:
        signal.proposed["depends_on"] = Setting(statuses, "its driver's own status")
    elif signal.has_bounds:
        signal.seen["depends_on"] = Setting(statuses, "a guess: its driver's own statuses")


def _depend_on_topics(node: Signal, published: Mapping[str, Sequence[Signal]]) -> None:
    """Lets a node depend on the silence of the topics that it publishes alone."""
    limits_s = {}
    for signals in published.values():
        stale_s = [limit_s for limit_s in (each.settings.get("stale_after_s") for each in signals) if limit_s]
        if stale_s:
            limits_s[f"/{signals[0].given['topic'].lstrip('/')}"] = min(stale_s)
    if limits_s:
        for_s = max(limits_s.values()) + _AFTER_S
        node.proposed["for_s"] = Setting(for_s, "longer than its topics may be silent")
        node.proposed["depends_on"] = Setting(list(limits_s), "their silence is the alert")
