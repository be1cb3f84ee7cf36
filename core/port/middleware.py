"""The port: what a node needs from a middleware, in rosbridge's vocabulary.

Implemented by `core/port/local.py`, `ros1/middleware.py`, `ros2/middleware.py`, `rosbridge/client/middleware.py` and
`recordings/`; used by `core/nodes/`. One `Middleware` is one node: it has a name, a namespace, parameters, topics and
services.

Every implementation guarantees:

* Messages are plain mappings in rosbridge's form: `{"data": 19.5}`, the `level` of a DiagnosticStatus as an int, byte
  arrays as base64 text. A `header` without a stamp is stamped when it is published.
* The types of std_msgs, std_srvs, sensor_msgs and diagnostic_msgs are always known. An implementation without message
  definitions accepts types of other packages unchecked.
* Type names are accepted in both spellings, `std_msgs/Float32` and `std_msgs/msg/Float32`.
* Names follow ROS: `topic` is relative to the node's namespace, `/topic` absolute, `~name` private to the node.
* Callbacks never run concurrently: the adapter holds one lock per node, so nodes need none. It reads `now_s` while it
  holds the lock, so that no race makes time go back for a node.
* An exception in a callback is logged as one ERROR line and affects nothing else.
* `log` never raises and never blocks for long; a log that cannot be written is a fault.
* A burst of several hundred messages on one topic is queued for publishing, not dropped.
* No callback after `close()`. `close()` may be called twice.
* Methods raise only the documented errors.
"""

from __future__ import annotations

import enum
from typing import Any, Callable, Collection, Mapping, NamedTuple, Protocol, Sequence, Tuple, TypeVar

from ..config import Parameter
from ..messages import RawFormat
from ..values import Faults, JsonObject, Message
from .graph import GraphCallback, Wanted

Callback = Callable[[Any, float], None]
"""Receives a value and the time of its arrival, in s."""


RawMessage = Tuple[bytes, RawFormat]
"""A message as bytes, with their format."""

RawCallback = Callable[[RawMessage, float], None]
"""Receives a message as bytes, and the time of its arrival, in s."""

OnChange = Callable[[JsonObject], str]
"""Takes a proposed configuration; see `Middleware.declare_parameters`."""

Result = TypeVar("Result")

NOTHING_CHANGED = "nothing changed"
"""What `on_change` of `Middleware.declare_parameters` returns for the configuration that is in force."""


class Severity(enum.IntEnum):
    """Severity of a log line; the numbers are those of rcl_interfaces/msg/Log and Python's `logging`."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


class Timer(Protocol):
    """A running timer."""

    def cancel(self) -> None:
        """Stops the timer. May be called twice, and from its own callback."""


class Subscription(Protocol):
    """A subscription, for `unsubscribe`."""

    @property
    def topic(self) -> str:
        """The fully resolved topic."""


class Middleware(Protocol):
    """One node's connection to a middleware."""

    @property
    def name(self) -> str:
        """The fully qualified node name, for instance `/robot1/alert_system`."""

    @property
    def faults(self) -> Faults:
        """Faults of this node; any part of it may report here."""

    def now_s(self) -> float:
        """Returns the time in seconds on which durations are measured.

        Monotonic by default; ROS time under `use_sim_time`, which may stand still or go back. Before the first message
        on /clock there is no ROS time: `now_s` is 0, incoming messages wait and timers do not run.
        """

    def waiting_for_clock(self) -> bool:
        """Returns True under `use_sim_time` before the first message on /clock."""

    def steady_s(self) -> float:
        """Returns monotonic seconds, also under `use_sim_time`."""

    def stamp_s(self) -> float:
        """Returns the time of the clock that stamps in messages use, in s since 1970; only for the ages of stamps.

        The wall clock of this machine, or ROS time under `use_sim_time`; the log time in a recording.
        """

    def given_parameters(self) -> JsonObject:
        """Returns this node's configuration, nested as in its file; ConfigError if the middleware's is no mapping."""

    def declare_parameters(self, parameters: Sequence[Parameter], on_change: OnChange) -> None:
        """Makes `parameters` visible, by dotted names, and changeable at run time; called once.

        `on_change` is called with the whole proposed tree, nested as `given_parameters` returns it. It returns what
        changed as one line, or `NOTHING_CHANGED`; that is the response of `~reload`, and one INFO line. Or it raises
        ConfigError to reject the change: the caller gets the reason, and the old values stay in force.

        Raises ConfigError if a given value does not match its parameter's type or range.
        """

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        """Announces that this node will publish on `topic`, and returns the fully resolved topic.

        A second call for the same topic does nothing. `latched`: a subscription with `latched` that begins later
        receives the last message, where the middleware has that. Publish it again from time to time: a rosbridge server
        need not have it. Raises ConfigError if the type is unknown or `topic` is not a name.
        """

    def publish(self, topic: str, message: Message) -> None:
        """Publishes a message, whose missing fields keep their defaults; None in a float field is NaN.

        Raises MessageError if `topic` is not advertised, or the message does not match its type.
        """

    def has_listeners(self, topic: str) -> bool:
        """Returns whether an advertised topic has subscribers; True where this is unknown. Raises as `publish`."""

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> Subscription:
        """Calls back with the value of a field for every message; with `latched`, for the last `latched` one at once.

        An empty `type_name` is the type with which the topic is advertised, now or later; a field that this type does
        not have is then one ERROR line in the log.

        `field` is a path as in `field_path.py` (`battery.percentage`, `cell_voltage[0]`, `status["motor"].level`),
        bound once. An index beyond the end of an array reads as None. A message in which no element has the key, or
        that cannot be read, reads as `field_path.ABSENT`: it is a sign of life. An empty `field` gives the whole
        message as a mapping, which costs a conversion. With None, the message is not read, nor deserialized where the
        middleware allows that; the value is 1.0. Behind the path may be a condition as in `where.py` (`data where level
        >= ERROR`, or without a path ` where level >= ERROR`, whose value is 1.0): a message for which it does not hold
        reads as ABSENT.

        Raises ConfigError if the type is unknown or has no such field, with topic, type and available fields. Also if
        `topic` is not a name.
        """

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> Subscription:
        """Calls back with every message as bytes: as they were transported, or as JSON where mappings are.

        `type_name`, the topics that appear later, `unsubscribe` and the errors are as of `subscribe`; so is the time,
        and the lock under which `callback` runs. A topic that is also used by `subscribe` is still received once, and
        nothing is decoded for this callback.

        The format comes with each message because it may be known only when the first one arrives (an empty
        `type_name`), and because a publisher may restart with another type or definition. It is the same object until
        then: compare with `is`. Messages whose type has no definition here come with an empty `schema` (JSON: one that
        allows any object), except on ROS 2, which needs the installed type. Where a server has to be asked for the
        definition, the callback receives the messages after its answer.
        """

    def serialize(self, type_name: str, message: Message) -> tuple[bytes, RawFormat]:
        """Returns a message as `subscribe_raw` would deliver it if this node published it.

        A header without a stamp is stamped. Raises ConfigError for an unknown type, MessageError for a wrong message.
        """

    def topic_types(self) -> Mapping[str, str]:
        """Returns the type of every topic with a publisher or subscriber, by its absolute name; empty if unknown.

        May wait for the network: call it from an own thread, never from a callback or with the lock of `exclusively`.
        Raises ServiceError if the middleware does not answer.
        """

    def why_silent(self, topic: str, type_name: str) -> str | None:
        """Returns why a topic that is subscribed to brings no samples, as a short text; None if nothing is known.

        Never waits. Where a server has to be asked, the first call returns None and asks; a later call returns the
        answer. However often it is called, each topic is looked up at most every 10 s. The texts are those of
        `hints.py`; a topic is named as resolved. An empty `type_name` stands for any type.
        """

    def graph_name(self, key: str, name: str) -> str:
        """Returns the resolved name of what a signal counts, remapped where the middleware remaps it; not of a pattern.

        Raises ServiceError if what signals with this key count is not known here, ConfigError if there is none.
        """

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> Timer:
        """Calls back every 1 to 2 s of steady time with what is wanted of the graph, or why it cannot be read.

        Reads in another thread or task if reading may wait; `wanted` is called there. Endpoints of this node are not
        counted.
        """

    def unsubscribe(self, subscription: Subscription) -> None:
        """Ends a subscription; does nothing if it has ended."""

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        """Offers a service (`std_srvs/Trigger`); `handler(request)` returns the response.

        If the handler raises, the log has one ERROR line. The caller gets a failed call (ROS 1, rosbridge) or, since
        ROS 2 has no failed calls, `success: false` with the error as `message`. Raises ConfigError if the type is
        unknown or `service` is not a name.
        """

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> Timer:
        """Calls `callback(now_s)` every `period_s` seconds of `now_s`, first after one period.

        Time that goes back (a looped bag, a reset simulator) restarts the period. Time that jumps ahead over several
        periods gives one call. `steady` measures on `steady_s`, for work that must go on while a simulator is paused.
        """

    def exclusively(self, function: Callable[[], Result]) -> Result:
        """Calls a function while no callback of this node runs, and returns its result. For code in other threads."""

    def log(self, severity: Severity, text: str) -> None:
        """Writes one line to the middleware's log."""

    def close(self) -> None:
        """Leaves the middleware: ends timers, subscriptions, publishers and services."""


class NodeInfo(NamedTuple):
    """Topics and services of one node, by fully resolved names."""

    publishes: Sequence[str]
    subscribes: Sequence[str]
    services: Sequence[str]


class Graph(NamedTuple):
    """The nodes, topics and services of a middleware at one moment, by fully resolved names."""

    topics: Mapping[str, str]
    """Type name per topic with a publisher or subscriber, in the middleware's spelling."""
    services: Mapping[str, str]
    """Type name per service; empty where the middleware does not know it."""
    nodes: Mapping[str, NodeInfo]


class ServedMiddleware(Middleware, Protocol):
    """What the rosbridge server needs besides the port, to serve a whole graph to its clients.

    These methods may wait for the network (except in `LocalMiddleware`): the server calls them from its own threads,
    never from a callback.
    """

    def graph(self) -> Graph:
        """Returns the current graph; raises ServiceError if the middleware, such as ROS 1's master, does not answer."""

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """Calls a service and returns its response; missing fields of the request keep their defaults.

        An empty `type_name` stands for the type in the graph. `timeout_s` limits finding the service and its answer
        together, in s.

        Raises:
            MessageError: the request does not match the service's type.
            ConfigError: `type_name` is unknown.
            ServiceError: the service does not exist, failed, or did not answer in time; `str()` says which.
        """

    def raw_format(self, type_name: str) -> RawFormat:
        """Returns the format in which `subscribe_raw` delivers messages of a type; raises ConfigError if unknown."""
