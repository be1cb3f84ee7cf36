"""The operations of rosbridge as tuples, and the readers that check what a peer sent.

The annotation of a field names its reader in `_READERS`; its default is used if the peer leaves it out. Unknown fields
are ignored, as ROSBRIDGE_PROTOCOL.md requires. Where the reference server differs from that document, both forms are
accepted.
"""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Type, Union, get_args

from .limits import Id, Limits, ProtocolError, shown

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
    Advertise, Unadvertise, Publish, Subscribe, Unsubscribe, CallService, ServiceResponse, AdvertiseService,
    UnadvertiseService, AdvertiseAction, UnadvertiseAction, SendActionGoal, CancelActionGoal, ActionFeedback,
    ActionResult, SetLevel, Status, Auth,
]  # fmt: skip

OPERATIONS: Dict[str, Type[Any]] = {
    re.sub(r"\B[A-Z]", r"_\g<0>", operation.__name__).lower(): operation for operation in get_args(Operation)
}
"""Every operation by its name on the wire (`SetLevel` is `set_level`); `fragment` and `png` carry other operations."""

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

_Reader = Callable[[object, Limits], object]
"""Returns the value of a field that a peer sent; raises ProtocolError if it is not as expected."""


def _unexpected(expected: str, found: object) -> ProtocolError:
    return ProtocolError(f"expected {expected}, got {shown(found)}")


def _if(is_valid: Callable[[Any], bool], expected: str) -> _Reader:
    def read(found: object, limits: Limits) -> object:
        if is_valid(found):
            return found
        raise _unexpected(expected, found)

    return read


def _read_name(found: object, limits: Limits) -> str:
    if not isinstance(found, str) or not found or len(found) > limits.name_chars or not found.isprintable():
        raise _unexpected(f"a name of 1 to {limits.name_chars} characters", found)
    return found


def _read_id(found: object, limits: Limits) -> Id:
    if found is None or (isinstance(found, int) and not isinstance(found, bool)):
        return found
    if isinstance(found, str) and len(found) <= limits.name_chars:
        return found
    raise _unexpected(f"a string of at most {limits.name_chars} characters or an integer", found)


def _read_number(found: object, limits: Limits) -> float:
    if isinstance(found, (int, float)) and not isinstance(found, bool) and -1e15 < found < 1e15:
        return float(found)
    raise _unexpected("a number", found)


def _read_positive(found: object, limits: Limits) -> float:
    number = _read_number(found, limits)
    if number < 0.0:
        raise _unexpected("a number, 0 or more", found)
    return number


def _read_size(found: object, limits: Limits) -> Optional[int]:
    if found is None:
        return None
    size = int(_read_positive(found, limits))
    if size < limits.fragment_chars:
        raise _unexpected(f"at least {limits.fragment_chars} characters", found)
    return size


def _read_arguments(found: object, limits: Limits) -> Union[Mapping[str, Any], List[Any]]:
    if found is None:
        return NO_FIELDS
    if isinstance(found, (dict, list)):
        return found
    raise _unexpected("an object or a list", found)


_READERS: Dict[str, _Reader] = {
    "Name": _read_name,
    "OptionalName": lambda found, limits: "" if found in (None, "") else _read_name(found, limits),
    "AnyId": _read_id,
    "Flag": _if(lambda found: isinstance(found, bool), "true or false"),
    "Count": lambda found, limits: int(_read_positive(found, limits)),
    "Milliseconds": _read_positive,
    "Seconds": lambda found, limits: None if found is None else _read_positive(found, limits),
    "Number": _read_number,
    "Size": _read_size,
    "Compression": _if(lambda found: found in COMPRESSIONS, f"one of {', '.join(COMPRESSIONS)}"),
    "StatusLevel": _if(lambda found: found in STATUS_LEVELS, f"one of {', '.join(STATUS_LEVELS)}"),
    "Text": _if(lambda found: isinstance(found, str), "a string"),
    "Fields": _if(lambda found: isinstance(found, dict), "an object"),
    "Arguments": _read_arguments,
    "Anything": lambda found, limits: found,
}


def _fields_of(operation: Type[Any]) -> Sequence[Tuple[str, _Reader, bool]]:
    """Returns (name, reader, required) per field."""
    kinds = {name: str(getattr(one, "__forward_arg__", one)) for name, one in operation.__annotations__.items()}
    return [(name, _READERS[kinds[name]], name not in operation._field_defaults) for name in operation._fields]


_FIELDS = {name: _fields_of(operation) for name, operation in OPERATIONS.items()}


def read_operation(fields: Mapping[str, Any], limits: Limits) -> Operation:
    """Returns the operation in a decoded message; raises ProtocolError if it or a field of it is not valid."""
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
