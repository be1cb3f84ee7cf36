"""Calls to the ROS master that always end, and the thread that notices when the master is lost or was restarted.

rospy's own calls have no timeout: a master that hangs would block whatever made the call. And rospy does not register
its topics with a new master: the node would go on without receiving anything.
"""

from __future__ import annotations

import http.client
import threading
import time
import xml.parsers.expat
import xmlrpc.client
from typing import Any, Callable, List, Tuple

import rosgraph
import rospy.core

from ..core.values import Clock, Level, ServiceError, describe, printable
from ..runtime.threads import StepThread

_SUCCESS = 1
_ERRORS = (
    OSError,
    http.client.HTTPException,
    xmlrpc.client.Error,
    xml.parsers.expat.ExpatError,
    ValueError,
    TypeError,
    LookupError,
)
"""What a failed call raises, and an answer that is not XML, not XML-RPC, or not of the expected form."""
_TIMEOUT_S = 3.0
_ROSPY_TIMEOUT_S = 10.0
_NODE_TIMEOUT_S = 1.0
_CHECK_PERIOD_S = 10.0
_LONGEST_CHECKS_S = 2.0
"""Time after which no further node is checked in one reading of the graph."""
_LONGEST_ERROR = 200

_State = List[Tuple[str, List[str]]]
SystemState = Tuple[_State, _State, _State]


class Master:
    """The ROS master of ROS_MASTER_URI. May be used from any thread. Calls raise ServiceError if it does not answer."""

    def __init__(self, caller: str, timeout_s: float = _TIMEOUT_S) -> None:
        """Does not connect yet. Raises ServiceError if ROS_MASTER_URI is not an address.

        `caller` is the name of the node; `timeout_s` limits connecting and each wait for the response, in s.
        """
        self._caller = caller
        self._timeout_s = timeout_s
        try:
            self.uri: str = rosgraph.get_master_uri()
            self._proxy()
        except (OSError, ValueError) as error:
            raise ServiceError(f"ROS_MASTER_URI: {error}") from None

    def is_online(self) -> bool:
        """Returns whether the master answers."""
        try:
            self._call("getPid")
        except ServiceError:
            return False
        return True

    def system_state(self) -> SystemState:
        """Returns publishers, subscribers and services, each a list of (name, [node, ...])."""
        state: SystemState = self._call("getSystemState", read=_state)
        return state

    def topic_types(self) -> dict[str, str]:
        """Returns the type of each topic."""
        types: dict[str, str] = self._call("getTopicTypes", read=_types)
        return types

    def find_service(self, name: str) -> str | None:
        """Returns the address of a service, `rosrpc://host:port`; None if there is no such service."""
        address: str | None = self._call("lookupService", name, read=_text, default=None)
        return address

    def answers(self, node: str) -> bool | None:
        """Returns whether a node answers its own API within 1 s: the master goes on listing one that crashed.

        False if it has left the master, or has no process any more. None if there is no answer, for whatever reason.
        """
        try:
            uri = self._call("lookupNode", node, read=_text, default=None)
            return uri is not None and bool(
                xmlrpc.client.ServerProxy(uri, _Transport(_NODE_TIMEOUT_S)).getPid(self._caller)
            )
        except ConnectionRefusedError:
            return False
        except _ERRORS:
            return None

    def parameter(self, name: str, default: Any) -> Any:
        """Returns a parameter, or `default` if it is not set."""
        return self._call("getParam", name, default=default)

    def set_parameter(self, name: str, value: Any) -> None:
        """Sets a parameter; a mapping replaces everything below it."""
        self._call("setParam", name, value)

    def identity(self, node: str) -> tuple[Any, ...] | None:
        """Returns what differs after a restart of the master; None if this master does not know the node."""
        if self._call("lookupNode", node, default=None) is None:
            return None
        return self._call("getPid"), self._call("getParam", "/run_id", default=None)

    def _call(
        self, method: str, *arguments: Any, read: Callable[[Any], Any] = lambda value: value, **default: Any
    ) -> Any:
        """Returns what `read` makes of an answer, or `default`, if it is given, of a refusal."""
        try:
            code, text, value = getattr(self._proxy(), method)(self._caller, *arguments)
            if code == _SUCCESS:
                return read(value)
        except _ERRORS as error:
            reason = printable(" ".join(str(error).split()))[:_LONGEST_ERROR]
            raise ServiceError(f"the ROS master at {self.uri} does not answer ({reason})") from None
        if default:
            return default["default"]
        raise ServiceError(f"the ROS master at {self.uri} refused {method}: {text}")

    def _proxy(self) -> xmlrpc.client.ServerProxy:
        """Returns a connection for one call: a ServerProxy is not thread-safe."""
        return xmlrpc.client.ServerProxy(self.uri, _Transport(self._timeout_s))


class NodeChecks:
    """Finds nodes that crashed: they did not answer twice, 10 s apart. Used in one thread."""

    def __init__(self, master: Master, clock: Clock = time.monotonic) -> None:
        """Checks nothing yet; `clock` returns monotonic seconds."""
        self._master = master
        self._clock = clock
        self._checks: dict[str, tuple[float, int]] = {}
        """When each node is checked next, in s, and how often it has not answered since it did last."""

    def gone(self, nodes: set[str]) -> set[str]:
        """Checks the nodes that are due, and returns those that are gone. Raises ServiceError as the master does."""
        begin_s = self._clock()
        self._checks = {node: self._checks.get(node, (begin_s, 0)) for node in nodes}
        for node in sorted(nodes, key=self._checks.__getitem__):
            due_s, misses = self._checks[node]
            if due_s > begin_s or self._clock() - begin_s > _LONGEST_CHECKS_S:
                break
            misses = 0 if self._master.answers(node) else misses + 1
            self._checks[node] = begin_s + (_CHECK_PERIOD_S if misses < 2 else 0.0), misses
        return {node for node, (_, misses) in self._checks.items() if misses >= 2}


class MasterWatch(StepThread):
    """Checks every few seconds that the master still knows this node. Close it before the node unregisters."""

    def __init__(
        self, master: Master, node: str, on_change: Callable[[str, Level], None], period_s: float = 2.0
    ) -> None:
        """Prepares the thread, for a node that the master knows now. Raises ServiceError if it does not answer.

        Calls `on_change` with what is wrong and how bad it is; with an empty text and OK when the master answers
        again.
        """
        super().__init__("master watch", self._check, bool)  # nothing in it raises
        self.lost = threading.Event()
        """Set when the master was restarted and does not know this node; this never heals, and the thread ends."""
        self._master = master
        self._node = node
        self._on_change = on_change
        self._period_s = period_s
        self._silent = 0
        self._identity = master.identity(node)

    def _check(self) -> float:
        try:
            identity = self._master.identity(self._node)
        except ServiceError as error:
            self._silent += 1
            if self._silent == 2:
                self._on_change(f"{error}: no new connections until it does", Level.WARN)
            return self._period_s
        if identity is None or identity != self._identity:
            if self.active:
                problem = f"the ROS master at {self._master.uri} was restarted and does not know this node"
                self._on_change(problem, Level.ERROR)
                self.lost.set()
            self.close()
        elif self._silent:
            self._silent = 0
            self._on_change("", Level.OK)
        return self._period_s


class _Transport(xmlrpc.client.Transport):
    """HTTP with a timeout."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__()
        self._timeout_s = timeout_s

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._timeout_s
        return connection


def _state(answer: Any) -> SystemState:
    publishers, subscribers, services = (
        [(str(name), [str(node) for node in nodes]) for name, nodes in kind] for kind in answer
    )
    return publishers, subscribers, services


def _types(answer: Any) -> dict[str, str]:
    return {str(topic): str(type_name) for topic, type_name in answer}


def _text(answer: Any) -> str:
    if not isinstance(answer, str):
        raise TypeError(f"expected text, got {describe(answer)}")
    return answer


def limit_calls_of_rospy(master: Master) -> None:
    """Gives the calls that rospy itself makes to the master a timeout of 10 s; call before `rospy.init_node`."""
    proxy = rospy.core._LockedServerProxy(master.uri, _Transport(_ROSPY_TIMEOUT_S))
    rospy.core._xmlrpc_cache[master.uri] = proxy
