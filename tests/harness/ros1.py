"""The conformance harness over rospy and a real master: everything goes through TCPROS."""

from __future__ import annotations

import base64
import functools
import itertools
import threading
from typing import Any, Callable, Mapping, Sequence

import genpy
import rosgraph
import roslib.message
import rospy
import yaml
from rosgraph_msgs.msg import Clock, Log

from harness.port_conformance import START_S, LogLine, ServiceFailed, poll_until
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.ros1.middleware import Ros1Middleware

_SEVERITIES = {
    Log.DEBUG: Severity.DEBUG,
    Log.INFO: Severity.INFO,
    Log.WARN: Severity.WARN,
    Log.ERROR: Severity.ERROR,
    Log.FATAL: Severity.FATAL,
}


class Ros1Harness:
    """Nodes in this process, which `rospy.init_node` has made a node under simulated time."""

    knows_listeners = True

    def __init__(self) -> None:
        self._nodes: list[Ros1Middleware] = []
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []
        self._pause = threading.Event()
        self._master = rosgraph.Master(rospy.get_name())
        _for_all_tests()
        self._wait_for_connections("/rosout")
        marker = LogLine(Severity.INFO, f"test {next(_numbers)} begins")
        rospy.loginfo(marker.text)
        self.wait_until(lambda: marker in _log)
        self._first_line = len(_log)
        self.set_time(START_S)

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool = True,
    ) -> Ros1Middleware:
        full_name = f"/{namespace}/{name}" if namespace else f"/{name}"
        if not sim_time:
            rospy.rostime.switch_to_wallclock()
        if remap:
            self._remap(full_name, remap)
        if parameters:
            rospy.set_param(f"{full_name}/ros__parameters", dict(parameters))
        node = Ros1Middleware(full_name)
        self._nodes.append(node)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        cls = roslib.message.get_message_class(type_name)
        if topic not in self._publishers:
            self._publishers[topic] = rospy.Publisher(topic, cls, queue_size=100, tcp_nodelay=True)
        native = cls()
        genpy.message.fill_message_args(native, [_as_genpy_wants(cls, message)])
        self._wait_for_connections(topic)
        self._publishers[topic].publish(native)

    def services(self) -> set[str]:
        """Returns the names of all services that there are."""
        return {name for name, _ in self._master.getSystemState()[2]}

    def listen(self, topic: str, type_name: str) -> list[Mapping[str, Any]]:
        messages: list[Mapping[str, Any]] = []
        cls = roslib.message.get_message_class(type_name)

        def hear(native: Any) -> None:
            # A node in this process may read the bytes, and a process has one class per topic.
            message = cls().deserialize(native._buff) if isinstance(native, rospy.AnyMsg) else native
            messages.append(_as_mapping(message))

        self._subscribers.append(rospy.Subscriber(topic, cls, hear, tcp_nodelay=True))
        self._wait_for_connections(topic)
        return messages

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        cls = roslib.message.get_service_class(type_name)
        native = cls._request_class()
        genpy.message.fill_message_args(native, [dict(request or {})])
        try:
            return _as_mapping(rospy.ServiceProxy(service, cls).call(native))
        except rospy.ServiceException as error:
            raise ServiceFailed(str(error)) from error

    def propose(self, node: Ros1Middleware, name: str, value: object) -> str:
        parameter = "/".join([node.name, "ros__parameters", *name.split(".")])
        before = rospy.get_param(parameter, None)
        rospy.set_param(parameter, value)
        response = self.call(f"{node.name}/reload", "std_srvs/Trigger")
        if response["success"]:
            return ""
        if before is None:
            rospy.delete_param(parameter)
        else:
            rospy.set_param(parameter, before)
        return str(response["message"])

    def set_time(self, now_s: float) -> None:
        now = genpy.Time.from_sec(now_s)
        self._wait_for_connections("/clock")
        _for_all_tests().publish(now)
        self.wait_until(lambda: rospy.get_rostime() == now and self._have_nodes_seen(now_s))

    def log_lines(self) -> Sequence[LogLine]:
        return _log[self._first_line :]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        # Most things take milliseconds; later looks are rarer, since many are requests to the master.
        pauses_s = itertools.chain(itertools.repeat(0.002, 10), itertools.repeat(0.02))
        poll_until(predicate, lambda: self._pause.wait(next(pauses_s)))

    def close(self) -> None:
        for node in self._nodes:
            node.close()
            if rospy.has_param(node.name):
                rospy.delete_param(node.name)
        for topic in (*self._publishers.values(), *self._subscribers):
            topic.unregister()
        self._remap("/tests", {})

    def _have_nodes_seen(self, now_s: float) -> bool:
        """Whether the timers of every node have been called that are due."""
        simulated = [node for node in self._nodes if not node.closed and node._sim_time_s is not None]
        return all(node.exclusively(node.now_s) == now_s for node in simulated)

    def _remap(self, node_name: str, remap: Mapping[str, str]) -> None:
        """Remaps as `old:=new` on the command line of a node does."""
        rospy.names.reload_mappings(["node", *(f"{old}:={new}" for old, new in remap.items())])
        rospy.names.initialize_mappings(node_name)

    def _wait_for_connections(self, topic: str) -> None:
        """Waits until this process is connected to all publishers and subscribers of `topic` that the master knows."""
        manager = rospy.topics.get_topic_manager()
        outgoing, incoming = manager.get_publisher_impl(topic), manager.get_subscriber_impl(topic)

        def are_there() -> bool:
            publishers, subscribers, _ = self._master.getSystemState()
            sources, sinks = dict(publishers).get(topic, ()), dict(subscribers).get(topic, ())
            return (outgoing is None or outgoing.get_num_connections() >= len(sinks)) and (
                incoming is None or incoming.get_num_connections() >= len(sources)
            )

        self.wait_until(are_there)


_log: list[LogLine] = []
_numbers = itertools.count(1)


@functools.lru_cache(maxsize=None)
def _for_all_tests() -> Any:
    """Returns the publisher of /clock, and begins to listen to the log; both stay until the process ends."""
    rospy.Subscriber("/rosout", Log, lambda line: _log.append(LogLine(_SEVERITIES[line.level], line.msg)))
    return rospy.Publisher("/clock", Clock, queue_size=100, tcp_nodelay=True)


def _as_mapping(native: Any) -> dict[str, Any]:
    """Parses rospy's printed form of a message, which is YAML: no code is shared with the adapter."""
    return yaml.safe_load(str(native)) or {}


def _as_genpy_wants(cls: Any, message: Mapping[str, Any]) -> dict[str, Any]:
    types = dict(zip(cls.__slots__, cls._slot_types))
    plain = {name: _with_ros1_stamps(value) for name, value in message.items()}
    return {
        name: base64.b64decode(value) if types[name] == "uint8[]" and isinstance(value, str) else value
        for name, value in plain.items()
    }


def _with_ros1_stamps(value: Any) -> Any:
    if isinstance(value, Mapping):
        if set(value) == {"sec", "nanosec"}:
            return {"secs": value["sec"], "nsecs": value["nanosec"]}
        return {name: _with_ros1_stamps(part) for name, part in value.items()}
    return value
