"""The conformance harness over rclpy: two DDS participants, the nodes under test in one, the test in the other."""

from __future__ import annotations

import array
import base64
import itertools
import math
import threading
import time
import traceback
from typing import Any, Callable, Mapping, Sequence

import rclpy
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from rosidl_parser.definition import AbstractSequence, Array, NamespacedType

from harness.port_conformance import START_S, LogLine, ServiceFailed, poll_until
from robot_health_monitor.core.config.parameters import flatten
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.ros2.middleware import Ros2Middleware

_MATCH_S = 5.0
"""Longest wait for endpoints to be matched, in s."""
_NO_TYPE_DESCRIPTIONS = Parameter("start_type_description_service", value=False)
"""rclpy does not remove this service with its node."""


class Participant:
    """An rclpy context with one executor, as in a process."""

    def __init__(self, domain_id: int, executor_class: Any = SingleThreadedExecutor) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.executor = executor_class(context=self.context)
        # Cyclone DDS does not watch the graph while a context has no node, and never forgets what left meanwhile.
        self._first_node = self._create_node("participant")

    def node(self, name: str) -> Node:
        node = self._create_node(name)
        self.executor.add_node(node)
        return node

    def close(self) -> None:
        self._first_node.destroy_node()
        rclpy.shutdown(context=self.context)

    def _create_node(self, name: str) -> Node:
        return Node(
            name,
            context=self.context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[_NO_TYPE_DESCRIPTIONS],
        )


class Spinner:
    """Spins a participant in a separate thread, as its process would."""

    def __init__(self, participant: Participant) -> None:
        self.failure: BaseException | None = None
        self._participant = participant
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._participant.close()
        self._thread.join(10)
        assert not self._thread.is_alive()

    def raise_failure(self) -> None:
        """Raises what was raised while spinning since the last call."""
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure

    def _spin(self) -> None:
        while self._participant.context.ok():
            try:
                # not spin(): with the EventsExecutor of the builds for pip it never gets round to anything
                self._participant.executor.spin_until_future_complete(Future(), 3600.0)
            except rclpy.executors.ExternalShutdownException:
                return
            except Exception as error:  # goes on, as the executables do: the next tests need this thread
                if not _is_of_closing(error):
                    self.failure = error


def _is_of_closing(error: Exception) -> bool:
    """Returns whether rclpy found a destroyed entity while it looked for work.

    It does if another thread closes a node meanwhile, as tests do. A process closes its nodes after spinning.
    """
    frames = traceback.extract_tb(error.__traceback__)
    return isinstance(error, InvalidHandle) and any(frame.name == "wait_for_ready_callbacks" for frame in frames)


class Ros2Harness:
    """Nodes under test spin in their own thread; the outside spins while a test waits."""

    knows_listeners = True

    def __init__(self, inside: Participant, outside: Participant, spinner: Spinner) -> None:
        self._inside, self._outside, self._spinner = inside, outside, spinner
        self._witness = inside.node("witness")
        self._me = outside.node("outside")
        self._nodes: list[Ros2Middleware] = []
        self._simulated: list[Ros2Middleware] = []
        self._publishers: dict[str, Any] = {}
        self._now_s = START_S
        self._log: list[LogLine] = []
        everything = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._me.create_subscription(Log, "/rosout", self._keep, everything)
        self._clock = self._me.create_publisher(Clock, "/clock", 10)

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool | None = True,
        before_time: Callable[[Ros2Middleware], object] = lambda node: None,
    ) -> Ros2Middleware:
        """See `Harness.node`.

        Args:
            name: as there.
            namespace: as there.
            parameters: as there.
            remap: as there.
            sim_time: as there; None: the parameter is not given.
            before_time: called with the node before it has seen simulated time.
        """
        arguments = ["--ros-args"]
        for old, new in (remap or {}).items():
            arguments += ["-r", f"{old}:={new}"]
        overrides = [_NO_TYPE_DESCRIPTIONS]
        overrides += [Parameter(key, value=value) for key, value in flatten(parameters or {})]
        if sim_time is not None:
            overrides.append(Parameter("use_sim_time", value=sim_time))
        node = Ros2Middleware(
            name,
            self._inside.context,
            namespace=namespace,
            cli_args=arguments,
            use_global_arguments=False,
            parameter_overrides=overrides,
        )
        self._nodes.append(node)
        before_time(node)
        self._inside.executor.add_node(node.node)
        if sim_time:
            self._simulated.append(node)
            self.set_time(self._now_s)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        cls = _message_class(type_name)
        if topic not in self._publishers:
            self._publishers[topic] = self._me.create_publisher(cls, topic, 100)
        publisher = self._publishers[topic]
        # Those that do not know the topic's type yet subscribe in fact when they have seen this publisher.
        undecided = [subscription for node in self._nodes for subscription in node._subscriptions]
        self.wait_until(lambda: not any(s.channel is None and s.active and s.topic == topic for s in undecided))
        self._wait_until_matched(topic, publisher.get_subscription_count, self._witness.get_subscriptions_info_by_topic)
        # Each side matches separately: a subscriber loses what was published before it knew the publisher.
        self._wait_until_matched(topic, lambda: self._known_publishers(topic), self._me.get_publishers_info_by_topic)
        publisher.publish(fill(cls(), message))

    def publish_to_process(self, topic: str, type_name: str, message: Mapping[str, Any], subscribers: int = 1) -> None:
        """Publishes to processes, which are not among the harness' own nodes: waits until so many have subscribed."""
        cls = _message_class(type_name)
        if topic not in self._publishers:
            self._publishers[topic] = self._me.create_publisher(cls, topic, 100)
        self.wait_until(lambda: self._publishers[topic].get_subscription_count() >= subscribers)
        self._publishers[topic].publish(fill(cls(), message))

    def connect_to_process(
        self, topic: str, message: Mapping[str, Any], signal: str, diagnostics: str = "/diagnostics"
    ) -> None:
        """Publishes a Float32 to an alert_system in another process until its reports show that a sample has arrived.

        The two ends of a connection become ready separately, and what is published before is lost. Afterwards the
        process also publishes to what `listen` has subscribed before: it learns of subscriptions in their order.
        """
        reports = self.listen(diagnostics, "diagnostic_msgs/DiagnosticArray")
        attempts = itertools.count()

        def has_arrived() -> bool:
            if next(attempts) % 5 == 0:
                self.publish_to_process(topic, "std_msgs/Float32", message)
            statuses = [status for report in reports for status in report["status"]]
            values = [status["values"] for status in statuses if status["name"].endswith(f": {signal}")]
            return any(each["key"] == "state" and each["value"] != "waiting" for each in itertools.chain(*values))

        self.wait_until(has_arrived)

    def services(self) -> set[str]:
        """Returns the names of all services that there are."""
        return {name for name, _ in self._witness.get_service_names_and_types()}

    def listen(self, topic: str, type_name: str) -> list[Mapping[str, Any]]:
        messages: list[Mapping[str, Any]] = []
        subscription = self._me.create_subscription(
            _message_class(type_name), topic, lambda native: messages.append(as_mapping(native)), 100
        )
        publishers = [
            publisher for node in self._nodes for publisher in node.node.publishers if publisher.topic_name == topic
        ]

        def is_connected() -> bool:
            subscribers = self._witness.get_subscriptions_info_by_topic(topic)
            return any(subscriber.node_name == "outside" for subscriber in subscribers) and all(
                publisher.get_subscription_count() >= len(subscribers) for publisher in publishers
            )

        self.wait_until(is_connected)
        self._wait_until_matched(topic, subscription.get_publisher_count, self._witness.get_publishers_info_by_topic)
        return messages

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        package, name = type_name.split("/")
        cls = getattr(__import__(f"{package}.srv", fromlist=[name]), name)
        return as_mapping(self._call(service, cls, fill(cls.Request(), request or {})))

    def propose(self, node: Ros2Middleware, name: str, value: object) -> str:
        return self.propose_to(node.name, name, value)

    def propose_to(self, node_name: str, name: str, value: object) -> str:
        """Changes a parameter of the node of this name; returns the reason of a refusal."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        (result,) = self._call(f"{node_name}/set_parameters", SetParameters, request).results
        assert result.successful == (not result.reason)
        return str(result.reason)

    def set_time(self, now_s: float) -> None:
        self._now_s = now_s
        now = Time(nanoseconds=round(now_s * 1e9))
        attempts = 0

        def is_shown() -> bool:
            working = self._inside.executor.get_nodes()
            return all(node.now_s() == now_s for node in self._simulated if node.node in working)

        def publish() -> None:
            nonlocal attempts
            if attempts % 50 == 0:  # /clock is best effort: a node that has only just appeared may miss a message
                self._clock.publish(Clock(clock=now.to_msg()))
            attempts += 1
            self._outside.executor.spin_once(timeout_sec=0.005)

        publish()
        poll_until(is_shown, publish)

    def log_lines(self) -> Sequence[LogLine]:
        return list(self._log)

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        # Most things take milliseconds; later looks are rarer, since each costs a round of the executor.
        pauses_s = itertools.chain(itertools.repeat(0.005, 20), itertools.repeat(0.02))
        poll_until(predicate, lambda: self._outside.executor.spin_once(timeout_sec=next(pauses_s)))
        self._spinner.raise_failure()

    def close(self) -> None:
        for node in self._nodes:
            node.close()
        for own, participant in ((self._witness, self._inside), (self._me, self._outside)):
            participant.executor.remove_node(own)
            own.destroy_node()
        self._wait_until_forgotten()
        self._spinner.raise_failure()

    def _known_publishers(self, topic: str) -> float:
        """Returns how many publishers each subscription of the nodes under test is matched with, at least."""
        counts = [math.inf]
        working = self._inside.executor.get_nodes()
        for node in self._nodes:
            if node.node in working:
                with node._lock:  # it replaces subscriptions
                    channels = [channel for channel in node._channels.values() if channel.key[0] == topic]
                    counts += [channel.native.get_publisher_count() for channel in channels]
        return min(counts)

    def _wait_until_matched(self, topic: str, count: Callable[[], float], find: Callable[[str], Sequence[Any]]) -> None:
        """Waits until an endpoint is matched with every other one of its topic.

        The graph may name more of them, such as those of a process that was killed, which only a timeout removes. Those
        never match: after 5 s the ones that did are enough.
        """
        end_s = time.monotonic() + _MATCH_S
        self.wait_until(lambda: count() >= len(find(topic)) or time.monotonic() > end_s)

    def _wait_until_forgotten(self) -> None:
        """Waits until the spinning thread waits for nothing of the closed nodes any more.

        Only then are they gone; rcl has one /rosout publisher per name of a node, so a next one of that name would
        lose its log with them.
        """
        for _ in range(2):
            gone_round = threading.Event()
            self._inside.executor.create_task(gone_round.set)
            assert gone_round.wait(30.0)

    def _call(self, service: str, cls: Any, request: Any) -> Any:
        if self._is_of_closed_node(service):
            raise ServiceFailed(f"no such service: {service}")
        client = self._me.create_client(cls, service)
        self.wait_until(client.service_is_ready)
        answer = client.call_async(request)
        self.wait_until(answer.done)
        self._me.destroy_client(client)
        return answer.result()

    def _is_of_closed_node(self, service: str) -> bool:
        if self._witness.count_services(service):
            return False
        working = self._inside.executor.get_nodes()
        return any(node.node not in working for node in self._nodes)

    def _keep(self, line: Log) -> None:
        level = line.level if isinstance(line.level, int) else line.level[0]
        self._log.append(LogLine(Severity(level), line.msg))


_ROS2_NAMES = {"secs": "sec", "nsecs": "nanosec"}
"""The parts of a stamp, by their names in ROS 1."""


def as_mapping(native: Any) -> dict[str, Any]:
    """Returns a message's fields, nested; nothing here shares code with the adapter."""
    return {name: _plain(getattr(native, name)) for name in native.get_fields_and_field_types()}


def fill(native: Any, message: Mapping[str, Any]) -> Any:
    """Sets a message's fields from a mapping, with rclpy's own checks of what is set switched on."""
    native = type(native)(check_fields=True)
    types = dict(zip(native.get_fields_and_field_types(), native.SLOT_TYPES))
    for given, value in message.items():
        name = _ROS2_NAMES.get(given, given)
        setattr(native, name, _native(value, types[name], getattr(native, name)))
    return native


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return as_mapping(value)
    if isinstance(value, array.array) and value.typecode == "B":
        return value.tobytes()
    if isinstance(value, (list, tuple)):
        return [_plain(element) for element in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _native(value: Any, slot_type: Any, default: Any) -> Any:
    if isinstance(value, Mapping):
        return fill(default, value)
    if isinstance(slot_type, (AbstractSequence, Array)):
        if isinstance(slot_type.value_type, NamespacedType):
            cls = _message_class(f"{slot_type.value_type.namespaces[0]}/{slot_type.value_type.name}")
            return [fill(cls(), element) for element in value]
        if isinstance(value, str):
            return array.array("B", base64.b64decode(value))
        return value
    if getattr(slot_type, "typename", "") == "octet":
        return bytes([value])
    return float(value) if isinstance(default, float) else value


def _message_class(type_name: str) -> Any:
    package, name = type_name.split("/")
    return getattr(__import__(f"{package}.msg", fromlist=[name]), name)
