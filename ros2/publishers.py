"""What discovery has found about the publishers of a topic. Reading the graph does not wait for the network."""

from __future__ import annotations

from typing import Collection, Dict, List, Mapping, Sequence, Tuple

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ..core.port.hints import Answer, explain


def full_name(name: str, namespace: str) -> str:
    """Returns the fully qualified name of a node."""
    return f"{namespace.rstrip('/')}/{name}"


def node_names(node: Node) -> List[str]:
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

    def __init__(self, node: Node) -> None:
        """Reads nothing yet."""
        self._node = node
        self._publishers: Dict[str, Tuple[int, Collection[str]]] = {}
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
        answer(explain(topic, type_name, types, gone))


def _nodes_of(publishers: Sequence[TopicEndpointInfo]) -> Collection[str]:
    return {full_name(each.node_name, each.node_namespace) for each in publishers}
