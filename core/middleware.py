"""The port: what a node needs from a middleware, in rosbridge's vocabulary.

Implemented by `core/local.py`, `ros1/middleware.py`, `ros2/middleware.py` and `rosbridge/client/middleware.py`; used by
`core/nodes/`. One `Middleware` is one node: it has a name, a namespace, parameters, topics and services.

Every implementation guarantees:

* Messages are plain mappings shaped as rosbridge shapes them: `{"data": 19.5}`, a DiagnosticStatus' `level` as an
  int, byte arrays as base64 text. A `header` whose stamp is left out is stamped when it is published.
* Type names are accepted in both spellings, `std_msgs/Float32` and `std_msgs/msg/Float32`.
* Names follow ROS: `topic` is relative to the node's namespace, `/topic` absolute, `~name` private to the node.
* Callbacks never run concurrently: the adapter holds one lock per node, so nodes need none. It reads `now_s` while it
  holds the lock, so the times that a node receives never go back because of a race.
* An exception in a callback is logged as one ERROR line and affects nothing else.
* `log` never raises and never blocks for long, even if the log cannot be written.
* No callback after `close()`. `close()` may be called twice.
"""

from __future__ import annotations

import enum
from typing import Any, Callable, Mapping, NamedTuple, Optional, Protocol, Sequence

from .faults import Faults
from .parameters import Parameter

Message = Mapping[str, Any]
"""A message, request or response as rosbridge shapes it."""


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
        """Stops it; it does not call back again. May be called twice, and from its own callback."""


class Subscription(Protocol):
    """A subscription, to be given back to `unsubscribe`."""

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
        """What keeps this node from working; any part of it may report here."""

    def now_s(self) -> float:
        """Returns the time in seconds on which durations are measured.

        Monotonic by default; ROS time under `use_sim_time`, which may stand still or go back. Before the first message
        on /clock there is no ROS time: `now_s` is 0, incoming messages wait and timers do not run.
        """

    def waiting_for_clock(self) -> bool:
        """Returns True under `use_sim_time` before the first message on /clock."""

    def steady_s(self) -> float:
        """Returns monotonic seconds, also under `use_sim_time`."""

    def given_parameters(self) -> Mapping[str, Any]:
        """Returns what was configured for this node, nested as in the file under `ros__parameters`."""

    def declare_parameters(
        self, parameters: Sequence[Parameter], on_change: Callable[[Mapping[str, Any]], str]
    ) -> None:
        """Makes `parameters` visible and changeable while the node runs; called once.

        Args:
            parameters: names are dotted paths below the node (`signals.battery_level.warn_below`).
            on_change: called with the whole proposed tree, nested as `given_parameters` returns it. It returns what
                changed as one line (`nothing changed`), which is the response of `~reload`, or raises ConfigError to
                reject the change: the caller gets the reason, and the old values stay in force.
        """

    def advertise(self, topic: str, type_name: str) -> None:
        """Announces that this node will publish on `topic`; a second call for the same topic does nothing.

        Raises:
            ConfigError: the type is not known here.
        """

    def publish(self, topic: str, message: Message) -> None:
        """Publishes on an advertised topic; fields that are left out keep their defaults.

        Raises:
            MessageError: `topic` is not advertised, or the message does not match its type.
        """

    def has_listeners(self, topic: str) -> bool:
        """Returns whether an advertised topic has subscribers; True where this is unknown.

        Raises:
            MessageError: `topic` is not advertised.
        """

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, float], None], *, field: Optional[str] = ""
    ) -> Subscription:
        """Calls `callback(value, now_s)` for every message.

        Args:
            topic: where to listen.
            type_name: type of the messages; empty: the type of the topic, found out when somebody advertises it. A
                field that its type does not have is then one ERROR line in the log.
            callback: gets the value and the time of its arrival.
            field: path of the field to read, as in `field_path.py` (`battery.percentage`, `cell_voltage[0]`,
                `status["motor"].level`), bound once and read from the native message. An index beyond the end reads as
                None; while no element has the key, there is no call back. Empty: the whole message as a mapping,
                which costs a conversion. None: the message is not looked at, and not deserialised where the middleware
                allows that; the value is 1.0.

        Raises:
            ConfigError: the type is not known here, or has no such field; the message names topic, type and the
                fields that there are.
        """

    def unsubscribe(self, subscription: Subscription) -> None:
        """Ends a subscription."""

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        """Offers a service (`std_srvs/Trigger`); `handler(request)` returns the response.

        A handler that raises is one ERROR line in the log, and the caller gets a failed call (ROS 1, rosbridge) or,
        where the middleware has no failed calls (ROS 2), `success: false` with the error as `message`.

        Raises:
            ConfigError: the type is unknown.
        """

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> Timer:
        """Calls `callback(now_s)` every `period_s` seconds of `now_s`, first after one period.

        Time that goes back (a looped bag, a reset simulator) restarts the period. Time that jumps ahead over several
        periods gives one call.

        Args:
            period_s: the period in seconds.
            callback: called with `now_s`.
            steady: measure the period on `steady_s`, for work that a paused simulator must not stop.
        """

    def log(self, severity: Severity, text: str) -> None:
        """Writes one line to the middleware's log."""

    def close(self) -> None:
        """Leaves the middleware: ends timers, subscriptions, publishers and services."""


class NodeInfo(NamedTuple):
    """What one node of a graph does, by fully resolved names."""

    publishes: Sequence[str]
    subscribes: Sequence[str]
    services: Sequence[str]


class Graph(NamedTuple):
    """Who talks to whom: what a middleware can see of itself at one moment, by fully resolved names."""

    topics: Mapping[str, str]
    """Type name per topic that somebody publishes on or subscribes to, in the middleware's own spelling."""
    services: Mapping[str, str]
    """Type name per service; empty where the middleware does not tell."""
    nodes: Mapping[str, NodeInfo]


class ServedMiddleware(Middleware, Protocol):
    """What `rosbridge/server.py` needs besides the port, to show a whole graph to clients that speak rosbridge.

    These methods may wait for the network (`LocalMiddleware` excepted), so the server calls them from threads of its
    own and never from a callback.
    """

    def graph(self) -> Graph:
        """Returns the current graph.

        Raises:
            ServiceError: the middleware's name server does not answer.
        """

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """Calls a service and returns its response.

        Args:
            service: its name.
            type_name: its type; empty: the one that the graph tells.
            request: the fields; those left out keep their defaults.
            timeout_s: how long to wait for the service and for its answer together, in s.

        Raises:
            MessageError: the request does not match the service's type.
            ServiceError: the service does not exist, failed, or did not answer in time; `str()` says which.
        """

    def message_definition(self, type_name: str) -> str:
        """Returns a message type's definition with those of the types it holds, as `gendeps --cat` prints it.

        Empty where the middleware does not have it.
        """

    def subscribe_raw(self, topic: str, type_name: str, callback: Callable[[bytes, float], None]) -> Subscription:
        """Calls `callback(data, now_s)` for every message, with the bytes as the middleware transports them.

        Raises:
            ConfigError: the type is not known here, or there are no such bytes.
        """


def split_type_name(type_name: str) -> Optional[Sequence[str]]:
    """Splits `pkg/Type`, `pkg/msg/Type` or `pkg/srv/Type` into (package, type), None when it is none of these."""
    parts = type_name.split("/")
    if len(parts) == 3 and parts[1] in ("msg", "srv"):
        del parts[1]
    if len(parts) != 2 or not all(part.isidentifier() for part in parts):
        return None
    return parts


def resolve_name(name: str, node_name: str) -> str:
    """Resolves a ROS graph name against the fully qualified `node_name`.

    >>> resolve_name("alerts", "/robot1/alert_system")
    '/robot1/alerts'
    >>> resolve_name("~reset", "/robot1/alert_system")
    '/robot1/alert_system/reset'
    """
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        return f"{node_name}/{name[1:].lstrip('/')}"
    return f"{node_name.rpartition('/')[0]}/{name}"
