"""The operations of rosbridge as tuples, and the readers that check what a peer sent.

The annotation of a field names its reader in `_READERS`; its default is used if the peer leaves it out. Unknown fields
are ignored, as ROSBRIDGE_PROTOCOL.md requires. Where the reference server differs from that document, both forms are
accepted.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, Type, Union

from .errors import Id, ProtocolError, shown
from .limits import Limits

__all__ = [
    "Operation",
    "OPERATIONS",
    "COMPRESSIONS",
    "STATUS_LEVELS",
    "NO_FIELDS",
    "Advertise",
    "Unadvertise",
    "Publish",
    "Subscribe",
    "Unsubscribe",
    "CallService",
    "ServiceResponse",
    "AdvertiseService",
    "UnadvertiseService",
    "AdvertiseAction",
    "UnadvertiseAction",
    "SendActionGoal",
    "CancelActionGoal",
    "ActionFeedback",
    "ActionResult",
    "SetLevel",
    "Status",
    "Auth",
    "operation_fields",
    "read_operation",
]

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
STATUS_LEVELS = ("none", "error", "warning", "info")
"""Each level includes those before it."""

NO_FIELDS: Mapping[str, Any] = MappingProxyType({})
"""Default of `args` and `values`."""


class Advertise(NamedTuple):
    """Announces that the peer will publish on a topic."""

    topic: Name
    type: Name
    id: AnyId = None
    latch: Flag = False
    queue_size: Count = 0


class Unadvertise(NamedTuple):
    """Ends an `Advertise`."""

    topic: Name
    id: AnyId = None


class Publish(NamedTuple):
    """A message on a topic."""

    topic: Name
    msg: Fields
    id: AnyId = None


class Subscribe(NamedTuple):
    """Subscribes the peer to a topic."""

    topic: Name
    type: OptionalName = ""
    id: AnyId = None
    throttle_rate: Milliseconds = 0
    """Minimum time between two messages, in ms."""
    queue_length: Count = 0
    """Messages to queue under `throttle_rate`; 0: messages in between are dropped."""
    fragment_size: Size = None
    """Longer messages are sent in fragments of this many characters. None: no fragments."""
    compression: Compression = "none"


class Unsubscribe(NamedTuple):
    """Ends the subscription with this id, or all subscriptions to the topic if there is no id."""

    topic: Name
    id: AnyId = None


class CallService(NamedTuple):
    """Calls a service; `args` is a mapping, or a list of the fields in order."""

    service: Name
    args: Arguments = NO_FIELDS
    id: AnyId = None
    fragment_size: Size = None
    compression: Compression = "none"
    timeout: Seconds = None
    """Longest wait for the response, in s. None: the server's default."""


class ServiceResponse(NamedTuple):
    """The response to a `CallService`; if `result` is false, `values` is the reason as text."""

    service: Name
    values: Anything = NO_FIELDS
    result: Flag = True
    id: AnyId = None


class AdvertiseService(NamedTuple):
    """Announces that the peer provides a service."""

    service: Name
    type: Name
    id: AnyId = None


class UnadvertiseService(NamedTuple):
    """Ends an `AdvertiseService`."""

    service: Name
    id: AnyId = None


class AdvertiseAction(NamedTuple):
    """Announces that the peer provides an action."""

    action: Name
    type: Name
    id: AnyId = None


class UnadvertiseAction(NamedTuple):
    """Ends an `AdvertiseAction`."""

    action: Name
    id: AnyId = None


class SendActionGoal(NamedTuple):
    """Sends a goal to an action."""

    action: Name
    action_type: Name
    args: Arguments = NO_FIELDS
    feedback: Flag = False
    id: AnyId = None
    fragment_size: Size = None
    compression: Compression = "none"


class CancelActionGoal(NamedTuple):
    """Cancels a goal."""

    action: Name
    id: AnyId = None


class ActionFeedback(NamedTuple):
    """Feedback on a goal."""

    action: Name
    values: Anything = NO_FIELDS
    id: AnyId = None


class ActionResult(NamedTuple):
    """The result of a goal; `status` is that of action_msgs/GoalStatus."""

    action: Name
    values: Anything = NO_FIELDS
    status: Count = 0
    result: Flag = True
    id: AnyId = None


class SetLevel(NamedTuple):
    """Requests `status` operations of this level and worse."""

    level: StatusLevel
    id: AnyId = None


class Status(NamedTuple):
    """Reports the outcome of an operation."""

    level: StatusLevel
    msg: Text
    id: AnyId = None


class Auth(NamedTuple):
    """Proves knowledge of a shared secret, as defined by the package rosauth."""

    mac: Text
    client: Text
    dest: Text
    rand: Text
    t: Number
    """Time of creation, in s since 1970."""
    level: Text
    end: Number
    """End of validity, in s since 1970."""


Operation = Union[
    Advertise,
    Unadvertise,
    Publish,
    Subscribe,
    Unsubscribe,
    CallService,
    ServiceResponse,
    AdvertiseService,
    UnadvertiseService,
    AdvertiseAction,
    UnadvertiseAction,
    SendActionGoal,
    CancelActionGoal,
    ActionFeedback,
    ActionResult,
    SetLevel,
    Status,
    Auth,
]

OPERATIONS: Dict[str, Type[Any]] = {
    "advertise": Advertise,
    "unadvertise": Unadvertise,
    "publish": Publish,
    "subscribe": Subscribe,
    "unsubscribe": Unsubscribe,
    "call_service": CallService,
    "service_response": ServiceResponse,
    "advertise_service": AdvertiseService,
    "unadvertise_service": UnadvertiseService,
    "advertise_action": AdvertiseAction,
    "unadvertise_action": UnadvertiseAction,
    "send_action_goal": SendActionGoal,
    "cancel_action_goal": CancelActionGoal,
    "action_feedback": ActionFeedback,
    "action_result": ActionResult,
    "set_level": SetLevel,
    "status": Status,
    "auth": Auth,
}
"""Every operation by its name on the wire, except `fragment` and `png`, which carry other operations."""

_NAMES = {operation: name for name, operation in OPERATIONS.items()}

Name = str
OptionalName = str
AnyId = Id
Flag = bool
Count = int
Milliseconds = float
Seconds = Optional[float]
Number = float
Size = Optional[int]
Compression = str
StatusLevel = str
Text = str
Fields = Mapping[str, Any]
Arguments = Union[Mapping[str, Any], List[Any]]
Anything = Any


def _unexpected(expected: str, found: object) -> ProtocolError:
    return ProtocolError(f"expected {expected}, got {shown(found)}")


def _read_name(found: object, limits: Limits) -> str:
    if not isinstance(found, str) or not found or len(found) > limits.name_chars or not found.isprintable():
        raise _unexpected(f"a name of 1 to {limits.name_chars} characters", found)
    return found


def _read_optional_name(found: object, limits: Limits) -> str:
    return "" if found is None or found == "" else _read_name(found, limits)


def _read_id(found: object, limits: Limits) -> Id:
    if found is None or (isinstance(found, int) and not isinstance(found, bool)):
        return found
    if isinstance(found, str) and len(found) <= limits.name_chars:
        return found
    raise _unexpected(f"a string of at most {limits.name_chars} characters or an integer", found)


def _read_flag(found: object, limits: Limits) -> bool:
    if isinstance(found, bool):
        return found
    raise _unexpected("true or false", found)


def _read_number(found: object, limits: Limits) -> float:
    if isinstance(found, (int, float)) and not isinstance(found, bool) and -1e15 < found < 1e15:
        return float(found)
    raise _unexpected("a number", found)


def _read_positive(found: object, limits: Limits) -> float:
    number = _read_number(found, limits)
    if number < 0.0:
        raise _unexpected("a number, 0 or more", found)
    return number


def _read_optional_positive(found: object, limits: Limits) -> Optional[float]:
    return None if found is None else _read_positive(found, limits)


def _read_count(found: object, limits: Limits) -> int:
    return int(_read_positive(found, limits))


def _read_size(found: object, limits: Limits) -> Optional[int]:
    if found is None:
        return None
    size = int(_read_positive(found, limits))
    if size < limits.fragment_chars:
        raise _unexpected(f"at least {limits.fragment_chars} characters", found)
    return size


def _read_compression(found: object, limits: Limits) -> str:
    if isinstance(found, str) and found in COMPRESSIONS:
        return found
    raise _unexpected(f"one of {', '.join(COMPRESSIONS)}", found)


def _read_status_level(found: object, limits: Limits) -> str:
    if isinstance(found, str) and found in STATUS_LEVELS:
        return found
    raise _unexpected(f"one of {', '.join(STATUS_LEVELS)}", found)


def _read_text(found: object, limits: Limits) -> str:
    if isinstance(found, str):
        return found
    raise _unexpected("a string", found)


def _read_fields(found: object, limits: Limits) -> Mapping[str, Any]:
    if isinstance(found, dict):
        return found
    raise _unexpected("an object", found)


def _read_arguments(found: object, limits: Limits) -> Union[Mapping[str, Any], List[Any]]:
    if found is None:
        return NO_FIELDS
    if isinstance(found, (dict, list)):
        return found
    raise _unexpected("an object or a list", found)


def _read_anything(found: object, limits: Limits) -> object:
    return found


_READERS: Dict[str, Callable[[object, Limits], object]] = {
    "Name": _read_name,
    "OptionalName": _read_optional_name,
    "AnyId": _read_id,
    "Flag": _read_flag,
    "Count": _read_count,
    "Milliseconds": _read_positive,
    "Seconds": _read_optional_positive,
    "Number": _read_number,
    "Size": _read_size,
    "Compression": _read_compression,
    "StatusLevel": _read_status_level,
    "Text": _read_text,
    "Fields": _read_fields,
    "Arguments": _read_arguments,
    "Anything": _read_anything,
}


def _fields_of(operation: Type[Any]) -> Tuple[Tuple[str, Callable[[object, Limits], object], bool], ...]:
    """Returns (name, reader, required) per field."""
    defaults: Mapping[str, object] = operation._field_defaults
    return tuple((name, _READERS[_annotation(operation, name)], name not in defaults) for name in operation._fields)


def _annotation(operation: Type[Any], name: str) -> str:
    annotation = operation.__annotations__[name]
    return str(getattr(annotation, "__forward_arg__", annotation))


_FIELDS = {name: _fields_of(operation) for name, operation in OPERATIONS.items()}


def read_operation(fields: Mapping[str, Any], limits: Limits) -> Operation:
    """Returns the operation in a decoded message.

    Raises:
        ProtocolError: the operation is unknown, or a field is missing or of the wrong kind.
    """
    op = fields.get("op")
    found_id = fields.get("id")
    id = found_id if isinstance(found_id, (str, int)) else None  # noqa: A001 - the protocol's word
    if not isinstance(op, str) or op not in _FIELDS:
        raise ProtocolError(f"unknown operation {shown(op)}", id=id)
    values: Dict[str, object] = {}
    for name, read, required in _FIELDS[op]:
        if name in fields:
            try:
                values[name] = read(fields[name], limits)
            except ProtocolError as error:
                raise ProtocolError(f"{name}: {error.problem}", op, id) from None
        elif required:
            raise ProtocolError(f"field {name} is missing", op, id)
    return OPERATIONS[op](**values)  # type: ignore[no-any-return]  # all of them are in Operation


def operation_fields(operation: Operation) -> Dict[str, Any]:
    """Returns the fields of an operation as sent on the wire; defaults are left out."""
    defaults = operation._field_defaults
    fields: Dict[str, Any] = {"op": _NAMES[type(operation)]}
    for name, value in zip(operation._fields, operation):
        if name not in defaults or name in _ALWAYS_WRITTEN or value != defaults[name]:
            fields[name] = {} if value is NO_FIELDS else value
    return fields


_ALWAYS_WRITTEN = ("values", "result", "args", "status")
"""Peers expect these fields even if they have their default."""
