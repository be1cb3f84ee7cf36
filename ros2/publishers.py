"""What discovery has found about the publishers of a topic. Reading the graph does not wait for the network."""

from __future__ import annotations

import time
from typing import Callable, Collection, Mapping, Sequence

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ..core.port import INCOMPATIBLE_QOS, Answer, explain, similar_topic

_TOPICS_PERIOD_S = 1.0
"""Reading all topics takes milliseconds on a large graph, and several signals may need them at once."""


def full_name(name: str, namespace: str) -> str:
    """Returns the fully qualified name of a node."""
    return f"{namespace.rstrip('/')}/{name}"


def node_names(node: Node) -> list[str]:
    """Returns the fully qualified names of all nodes; one that several nodes have is there several times."""
    return [full_name(*each) for each in node.get_node_names_and_namespaces()]


def has_best_effort(node: Node, topic: str) -> bool:
    """Whether a publisher is best effort, so that a reliable subscription does not hear it."""
    publishers = node.get_publishers_info_by_topic(topic)
    return any(publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for publisher in publishers)


def are_latched(node: Node, topic: str) -> bool:
    """Whether there are publishers, and all of them keep messages for later subscribers (`transient_local`)."""
    publishers = node.get_publishers_info_by_topic(topic)
    durabilities = {publisher.qos_profile.durability for publisher in publishers}
    return durabilities == {DurabilityPolicy.TRANSIENT_LOCAL}


class PublisherLookup:
    """Why a topic brings no samples."""

    def __init__(self, node: Node, qos_of: Callable[[str], Sequence[QoSProfile]]) -> None:
        """Reads nothing yet; `qos_of` returns the QoS of the node's subscriptions to a topic."""
        self._node = node
        self._qos_of = qos_of
        self._published: Mapping[str, str] = {}
        self._read_s = float("-inf")
        self._publishers: dict[str, tuple[int, Collection[str]]] = {}
        """How many publishers each topic has now, and the nodes of the latest ones."""

    def remember(self, numbers: Mapping[str, int]) -> None:
        """Remembers the nodes that publish, by the number of publishers of each topic of interest."""
        before, self._publishers = self._publishers, {}
        for topic, number in numbers.items():
            last, nodes = before.get(topic, (0, ()))
            if number not in (0, last):
                nodes = _nodes_of(self._node.get_publishers_info_by_topic(topic))
            self._publishers[topic] = number, nodes

    def look_up(self, topic: str, type_name: str, answer: Answer) -> None:
        """Answers at once: why a topic brings no samples; None if nothing is known. See `hints.Hints`."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        types = [publisher.topic_type for publisher in publishers]
        gone: Collection[str] = ()
        if publishers:
            self._publishers[topic] = len(publishers), _nodes_of(publishers)
        elif topic in self._publishers:
            gone = set(self._publishers[topic][1]).difference(node_names(self._node))
        similar = similar_topic(topic, type_name, {} if publishers else self._read_published())
        text = explain(topic, type_name, types, gone, similar)
        if publishers and text is None and not self._can_receive(topic, publishers):
            text = INCOMPATIBLE_QOS
        answer(text)

    def _read_published(self) -> Mapping[str, str]:
        """Returns the topics that have publishers, with their types."""
        now_s = time.monotonic()
        if now_s - self._read_s >= _TOPICS_PERIOD_S:
            topics = self._node.get_topic_names_and_types()
            self._published = {name: types[0] for name, types in topics if self._node.count_publishers(name)}
            self._read_s = now_s
        return self._published

    def _can_receive(self, topic: str, publishers: Sequence[TopicEndpointInfo]) -> bool:
        wanted = self._qos_of(topic)
        checks = [qos_check_compatible(publisher.qos_profile, mine)[0] for publisher in publishers for mine in wanted]
        return not checks or any(check != QoSCompatibility.ERROR for check in checks)


def _nodes_of(publishers: Sequence[TopicEndpointInfo]) -> Collection[str]:
    return {full_name(each.node_name, each.node_namespace) for each in publishers}
