"""The operations of rosbridge that are read, as one schema: each field that is used, with its type, default and limits.

Other fields are ignored, as ROSBRIDGE_PROTOCOL.md requires. Where the reference server differs from that document,
both forms are accepted. What is sent are mappings in the form of the protocol.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Type, Union

from ...core.config import REQUIRED, declared, read_record
from ...core.values import JsonObject, MessageError, describe
from .limits import Id, ProtocolError

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
"""Messages of the compression `png`, which is for slow networks, are sent as with `none`: every client takes both."""
STATUS_LEVELS = ("none", "error", "warning", "info")
"""Each level includes those before it."""
_IGNORED = ("status", "auth", "action_result")
_NO_ACTIONS = "actions are not supported"
_REFUSED = {
    **dict.fromkeys(("advertise_action", "unadvertise_action", "cancel_action_goal", "action_feedback"), _NO_ACTIONS),
    "png": "png: received messages must not be compressed",
    "fragment": "fragment: received messages must be whole",
}

LONGEST_NAME = 512
"""Most characters of the name of a topic, service, action or type, and of an id."""

Arguments = Union[JsonObject, List[Any]]


def _name(default: Any = REQUIRED) -> Any:
    return declared(default, "", 1, LONGEST_NAME)


def _id() -> Any:
    return declared(None, "", None, LONGEST_NAME)


@dataclass(frozen=True)
class Advertise:
    """Announces that the peer will publish on a topic."""

    topic: str = _name()
    type: str = _name()


@dataclass(frozen=True)
class Unadvertise:
    """Ends an `Advertise`."""

    topic: str = _name()


@dataclass(frozen=True)
class Publish:
    """A message on a topic."""

    topic: str = _name()
    msg: JsonObject = declared(REQUIRED)


@dataclass(frozen=True)
class Subscribe:
    """Subscribes the peer to a topic."""

    topic: str = _name()
    type: str = _name("")
    id: Id = _id()
    throttle_rate: float = declared(0.0, "", 0)
    """Minimum time between two messages, in ms."""
    queue_length: int = declared(0, "", 0)
    """With 0, messages in between are left out under `throttle_rate`."""
    compression: str = declared("none", choices=COMPRESSIONS)


@dataclass(frozen=True)
class Unsubscribe:
    """Ends the subscription with this id, or all subscriptions to the topic if there is no id."""

    topic: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class CallService:
    """Calls a service; `args` is a mapping, or a list that is empty or has this mapping."""

    service: str = _name()
    args: Arguments = declared({})
    id: Id = _id()
    timeout: Optional[float] = declared(None, "", 0)
    """Longest wait for the response, in s; the server's default applies if it is None."""


@dataclass(frozen=True)
class ServiceResponse:
    """The response to a call; if `result` is false, `values` is the reason as text."""

    service: str = _name()
    values: Any = declared({})
    result: bool = declared(True)
    id: Id = _id()


@dataclass(frozen=True)
class AdvertiseService:
    """Announces that the peer provides a service."""

    service: str = _name()
    type: str = _name()


@dataclass(frozen=True)
class UnadvertiseService:
    """Ends an `AdvertiseService`."""

    service: str = _name()


@dataclass(frozen=True)
class SendActionGoal:
    """Sends a goal to an action."""

    action: str = _name()
    id: Id = _id()


@dataclass(frozen=True)
class SetLevel:
    """Requests `status` operations of this level and worse."""

    level: str = declared(REQUIRED, choices=STATUS_LEVELS)


_KINDS = (
    Advertise, Unadvertise, Publish, Subscribe, Unsubscribe, CallService, ServiceResponse, AdvertiseService,
    UnadvertiseService, SendActionGoal, SetLevel,
)  # fmt: skip

OPERATIONS: Dict[object, Type[Any]] = {re.sub(r"\B[A-Z]", r"_\g<0>", kind.__name__).lower(): kind for kind in _KINDS}
"""Every operation by its name on the wire: `SetLevel` is `set_level`."""


def read_operation(fields: JsonObject) -> Any:
    """Returns the operation in a decoded message, None for one that needs no action.

    Raises ProtocolError if it or a field of it is not valid.
    """
    op = fields.get("op")
    if op in _IGNORED:
        return None
    name = op if isinstance(op, str) else ""
    if name not in OPERATIONS:
        raise ProtocolError(_REFUSED.get(name, f"unknown operation {describe(op)}"))
    try:
        return read_record(OPERATIONS[name], fields)
    except MessageError as error:
        raise ProtocolError(f"{name}: {error}") from None
