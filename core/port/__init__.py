"""The port: what a node needs from a middleware, and the in-process implementation."""

from .clocked_node import ClockedNode
from .graph import NOT_COUNTED, Counts, GraphCallback, Unread, Wanted, count, is_pattern, matching, state_of
from .hints import INCOMPATIBLE_QOS, Answer, explain, similar_topic
from .local import LocalBus, LocalMiddleware, LogLine
from .log_limit import LimitedLog
from .mapping_node import CLOCK, CLOCK_TYPE, LoggedSubscription, MappingNode, MappingSubscription, RawSubscription
from .middleware import (
    NOTHING_CHANGED,
    Callback,
    Graph,
    Middleware,
    NodeInfo,
    OnChange,
    RawCallback,
    RawMessage,
    Result,
    ServedMiddleware,
    Severity,
    Subscription,
    Timer,
)
from .timers import ClockTimer

__all__ = [
    "Answer", "CLOCK", "CLOCK_TYPE", "Callback", "ClockTimer", "ClockedNode", "Counts", "Graph", "GraphCallback",
    "INCOMPATIBLE_QOS", "LimitedLog", "LocalBus", "LocalMiddleware", "LogLine", "LoggedSubscription", "MappingNode",
    "MappingSubscription", "Middleware", "NOTHING_CHANGED", "NOT_COUNTED", "NodeInfo", "OnChange", "RawCallback",
    "RawMessage", "RawSubscription", "Result", "ServedMiddleware", "Severity", "Subscription", "Timer", "Unread",
    "Wanted", "count", "explain", "is_pattern", "matching", "similar_topic", "state_of",
]  # fmt: skip
