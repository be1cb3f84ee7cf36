"""The operations of rosbridge, as one schema: each field that is used, with its type, default and limits.

Other fields are ignored, as ROSBRIDGE_PROTOCOL.md requires. Where the reference server differs from that document,
both forms are accepted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Optional, Type, Union, get_args

from ...core.config.schema import REQUIRED, declared, parameters, read_record
from ...core.values.errors import MessageError
from .limits import Id, ProtocolError, shown

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
STATUS_LEVELS = ("none", "error", "warning", "info")
"""Each level includes those before it."""
_ACTIONS = ("advertise_action", "unadvertise_action", "cancel_action_goal", "action_feedback")
"""Operations of actions, apart from a goal, which is aborted."""
_REFUSED = {
    **dict.fromkeys(_ACTIONS, "actions are not supported"),
    "png": "png: received messages must not be compressed",
}
MOST_FRAGMENTS = 10_000
"""Of one message."""

LONGEST_NAME = 512
"""Most characters of the name of a topic, service, action or type, and of an id."""
SMALLEST_FRAGMENT = 256
"""Fewest characters of the fragments that a peer may request: each costs about 100 bytes more."""

Arguments = Union[Mapping[str, Any], List[Any]]


def _name(default: Any = REQUIRED) -> Any:
    return declared(default, "", 1, LONGEST_NAME)


def _id() -> Any:
    return declared(None, "", None, LONGEST_NAME)


@dataclass(frozen=True)
class Advertise:
    """Announces that the peer will publish on a topic."""

    topic: str = _name()
    type: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class Unadvertise:
    """Ends an `Advertise`."""

    topic: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class Publish:
    """A message on a topic."""

    topic: str = _name()
    msg: Mapping[str, Any] = declared(REQUIRED)
    id: Id = _id()


@dataclass(frozen=True)
class Subscribe:
    """Subscribes the peer to a topic."""

    topic: str = _name()
    type: str = _name("")
    id: Id = _id()
    throttle_rate: float = declared(0.0, "", 0)
    """Minimum time between two messages, in ms."""
    queue_length: int = declared(0, "", 0)
    """Messages to queue under `throttle_rate`; 0: messages in between are dropped."""
    fragment_size: Optional[int] = declared(None, "", SMALLEST_FRAGMENT)
    """Longer messages are sent in fragments of this many characters. None: no fragments."""
    compression: str = declared("none", choices=COMPRESSIONS)


@dataclass(frozen=True)
class Unsubscribe:
    """Ends the subscription with this id, or all subscriptions to the topic if there is no id."""

    topic: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class CallService:
    """Calls a service; `args` is a mapping, or a list of the fields in order."""

    service: str = _name()
    args: Arguments = declared({})
    id: Id = _id()
    fragment_size: Optional[int] = declared(None, "", SMALLEST_FRAGMENT)
    compression: str = declared("none", choices=COMPRESSIONS)
    timeout: Optional[float] = declared(None, "", 0)
    """Longest wait for the response, in s; the server's default applies if it is None."""


@dataclass(frozen=True)
class ServiceResponse:
    """The response to a `CallService`; if `result` is false, `values` is the reason as text."""

    service: str = _name()
    values: Any = declared({})
    result: bool = declared(True)
    id: Id = _id()


@dataclass(frozen=True)
class AdvertiseService:
    """Announces that the peer provides a service."""

    service: str = _name()
    type: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class UnadvertiseService:
    """Ends an `AdvertiseService`."""

    service: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class SendActionGoal:
    """Sends a goal to an action."""

    action: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class ActionResult:
    """The result of a goal; `status` is that of action_msgs/GoalStatus."""

    action: str = _name()
    values: Any = declared({})
    status: int = declared(0, "", 0)
    result: bool = declared(True)
    id: Id = _id()


@dataclass(frozen=True)
class SetLevel:
    """Requests `status` operations of this level and worse."""

    level: str = declared(REQUIRED, choices=STATUS_LEVELS)
    id: Id = _id()


@dataclass(frozen=True)
class Status:
    """Reports the outcome of an operation."""

    level: str = declared(REQUIRED, choices=STATUS_LEVELS)
    msg: str = declared(REQUIRED, any_text=True)
    id: Id = _id()


@dataclass(frozen=True)
class Auth:
    """Proves knowledge of a shared secret, as defined by the package rosauth."""

    mac: str = declared(REQUIRED, any_text=True)
    client: str = declared(REQUIRED, any_text=True)
    dest: str = declared(REQUIRED, any_text=True)
    rand: str = declared(REQUIRED, any_text=True)
    t: float = declared(REQUIRED)
    """Time of creation, in s since 1970."""
    level: str = declared(REQUIRED, any_text=True)
    end: float = declared(REQUIRED)
    """End of validity, in s since 1970."""


@dataclass(frozen=True)
class Fragment:
    """A part of the JSON text of another operation."""

    id: Union[str, int] = declared(REQUIRED, "", None, LONGEST_NAME)
    data: str = declared(REQUIRED, any_text=True)
    total: float = declared(REQUIRED, "", 1, MOST_FRAGMENTS)
    """Rounded down, as `num`: the reference server sends 3.75 as the total of 3 fragments."""
    num: float = declared(REQUIRED, "", 0, MOST_FRAGMENTS)


Operation = Union[
    Advertise, Unadvertise, Publish, Subscribe, Unsubscribe, CallService, ServiceResponse, AdvertiseService,
    UnadvertiseService, SendActionGoal, ActionResult, SetLevel, Status, Auth, Fragment,
]  # fmt: skip

OPERATIONS: Dict[str, Type[Any]] = {
    re.sub(r"\B[A-Z]", r"_\g<0>", operation.__name__).lower(): operation for operation in get_args(Operation)
}
"""Every operation by its name on the wire: `SetLevel` is `set_level`."""
_NAMES = {kind: op for op, kind in OPERATIONS.items()}
_ALWAYS_WRITTEN = ("values", "result", "args", "status")
"""Peers expect these fields even if they have their default."""


def read_operation(fields: Mapping[str, Any]) -> Operation:
    """Returns the operation in a decoded message; raises ProtocolError if it or a field of it is not valid."""
    op = fields.get("op")
    name = op if isinstance(op, str) else ""
    schema = OPERATIONS.get(name)
    try:
        if schema is None:
            raise MessageError(_REFUSED.get(name, f"unknown operation {shown(op)}"))
        return read_record(schema, fields)  # type: ignore[no-any-return]  # all of them are in Operation
    except MessageError as error:
        given = fields.get("id")
        raise ProtocolError(
            str(error), name if schema else "", given if isinstance(given, (str, int)) else None
        ) from None


def operation_fields(operation: Operation) -> Dict[str, Any]:
    """Returns the fields of an operation as sent on the wire; defaults are left out."""
    given = vars(operation)
    written = [
        each.name
        for each in parameters(type(operation))
        if each.name in _ALWAYS_WRITTEN or given[each.name] != each.default
    ]
    return {"op": name_of(operation), **{name: given[name] for name in written}}


def name_of(operation: Operation) -> str:
    """Returns the name of an operation on the wire."""
    return _NAMES[type(operation)]
