"""The rosbridge v2 protocol as pure code: what arrives becomes operations, operations become what is sent.

Theory of operation. A `Connection` stands for one peer and holds nothing but the pieces of messages that are not
complete yet. `receive(data, now_s)` takes one WebSocket message and returns the operation in it, or None while pieces
are missing; `send(operation)` returns the texts or bytes to transmit. There is no socket, no clock and no thread here;
client and server use the same class, since the protocol is the same both ways.

The operations and their fields are the tuples below: a field's annotation names the reader that checks it (`_READERS`)
and its default says what leaving it out means. Everything else that a peer sends beside them is ignored, as the
protocol's own document (ROSBRIDGE_PROTOCOL.md) has it. Where the reference server and the document differ, both are
accepted. Whatever arrives, the only error raised is ProtocolError.
"""

from __future__ import annotations

import base64
import itertools
import json
from types import MappingProxyType
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, Type, Union

from .cbor import decode_cbor, encode_cbor
from .errors import Id, ProtocolError, shown
from .fragments import Reassembly, split
from .limits import DEFAULT_LIMITS, Limits
from .png import decode_png, encode_png

Wire = Union[str, bytes]
"""One WebSocket message: text, or binary when it is CBOR."""

CBOR_SUBPROTOCOL = "rosbridge.v2.cbor"
"""The WebSocket subprotocol by which this package's client and server agree to speak CBOR both ways."""

COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")
STATUS_LEVELS = ("none", "error", "warning", "info")
"""Each level includes those before it."""


NO_FIELDS: Mapping[str, Any] = MappingProxyType({})
"""What `args` and `values` are when they are left out."""


class Advertise(NamedTuple):
    """The peer will publish on a topic."""

    topic: Name
    type: Name
    id: AnyId = None
    latch: Flag = False
    queue_size: Count = 0


class Unadvertise(NamedTuple):
    """The peer will not publish on a topic any more."""

    topic: Name
    id: AnyId = None


class Publish(NamedTuple):
    """A message on a topic."""

    topic: Name
    msg: Fields
    id: AnyId = None


class Subscribe(NamedTuple):
    """The peer wants the messages of a topic."""

    topic: Name
    type: OptionalName = ""
    id: AnyId = None
    throttle_rate: Milliseconds = 0
    """Least time between two messages, in ms."""
    queue_length: Count = 0
    """How many messages wait for their time under `throttle_rate`; 0: those in between are left out."""
    fragment_size: Size = None
    """Most characters of one message; what is longer comes in fragments. None: no bound."""
    compression: Compression = "none"


class Unsubscribe(NamedTuple):
    """The peer no longer wants a topic: one subscription by its id, or without id all of them."""

    topic: Name
    id: AnyId = None


class CallService(NamedTuple):
    """A request to a service; `args` is a mapping, or a list of the fields in their order."""

    service: Name
    args: Arguments = NO_FIELDS
    id: AnyId = None
    fragment_size: Size = None
    compression: Compression = "none"
    timeout: Seconds = None
    """How long to wait for the answer, in s; None: as long as the server allows."""


class ServiceResponse(NamedTuple):
    """The answer to a request; when `result` is false, `values` is the reason as text."""

    service: Name
    values: Anything = NO_FIELDS
    result: Flag = True
    id: AnyId = None


class AdvertiseService(NamedTuple):
    """The peer answers requests to a service."""

    service: Name
    type: Name
    id: AnyId = None


class UnadvertiseService(NamedTuple):
    """The peer no longer answers requests to a service."""

    service: Name
    id: AnyId = None


class AdvertiseAction(NamedTuple):
    """The peer carries out an action."""

    action: Name
    type: Name
    id: AnyId = None


class UnadvertiseAction(NamedTuple):
    """The peer no longer carries out an action."""

    action: Name
    id: AnyId = None


class SendActionGoal(NamedTuple):
    """A goal for an action."""

    action: Name
    action_type: Name
    args: Arguments = NO_FIELDS
    feedback: Flag = False
    id: AnyId = None
    fragment_size: Size = None
    compression: Compression = "none"


class CancelActionGoal(NamedTuple):
    """A goal is given up."""

    action: Name
    id: AnyId = None


class ActionFeedback(NamedTuple):
    """News of a goal."""

    action: Name
    values: Anything = NO_FIELDS
    id: AnyId = None


class ActionResult(NamedTuple):
    """The end of a goal; `status` is that of action_msgs/GoalStatus."""

    action: Name
    values: Anything = NO_FIELDS
    status: Count = 0
    result: Flag = True
    id: AnyId = None


class SetLevel(NamedTuple):
    """The peer asks for `status` operations of this level and worse."""

    level: StatusLevel
    id: AnyId = None


class Status(NamedTuple):
    """What went wrong, or right, with an operation of the peer."""

    level: StatusLevel
    msg: Text
    id: AnyId = None


class Auth(NamedTuple):
    """Proof of a shared secret, as the package rosauth defines it."""

    mac: Text
    client: Text
    dest: Text
    rand: Text
    t: Number
    """When it was made, in s since 1970."""
    level: Text
    end: Number
    """Until when it holds, in s since 1970."""


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
"""Every operation by its name on the wire, besides the two that wrap others: `fragment` and `png`."""

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


def _read_name(found: object, limits: Limits) -> str:
    if not isinstance(found, str) or not found or len(found) > limits.name_chars or not found.isprintable():
        raise ProtocolError(f"found {shown(found)}, allowed is a name of 1 to {limits.name_chars} characters")
    return found


def _read_optional_name(found: object, limits: Limits) -> str:
    return "" if found is None or found == "" else _read_name(found, limits)


def _read_id(found: object, limits: Limits) -> Id:
    if found is None or (isinstance(found, int) and not isinstance(found, bool)):
        return found
    if isinstance(found, str) and len(found) <= limits.name_chars:
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is a text of up to {limits.name_chars} characters")


def _read_flag(found: object, limits: Limits) -> bool:
    if isinstance(found, bool):
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is true or false")


def _read_number(found: object, limits: Limits) -> float:
    if isinstance(found, (int, float)) and not isinstance(found, bool) and -1e15 < found < 1e15:
        return float(found)
    raise ProtocolError(f"found {shown(found)}, allowed is a number")


def _read_positive(found: object, limits: Limits) -> float:
    number = _read_number(found, limits)
    if number < 0.0:
        raise ProtocolError(f"found {shown(found)}, allowed is a number, 0 or more")
    return number


def _read_optional_positive(found: object, limits: Limits) -> Optional[float]:
    return None if found is None else _read_positive(found, limits)


def _read_count(found: object, limits: Limits) -> int:
    return int(_read_positive(found, limits))


def _read_size(found: object, limits: Limits) -> Optional[int]:
    if found is None:
        return None
    size = int(_read_positive(found, limits))
    if size < 1:
        raise ProtocolError(f"found {shown(found)}, allowed is a whole number, 1 or more")
    return size


def _read_compression(found: object, limits: Limits) -> str:
    if isinstance(found, str) and found in COMPRESSIONS:
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is one of {', '.join(COMPRESSIONS)}")


def _read_status_level(found: object, limits: Limits) -> str:
    if isinstance(found, str) and found in STATUS_LEVELS:
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is one of {', '.join(STATUS_LEVELS)}")


def _read_text(found: object, limits: Limits) -> str:
    if isinstance(found, str):
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is a text")


def _read_fields(found: object, limits: Limits) -> Mapping[str, Any]:
    if isinstance(found, dict):
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is a mapping of fields")


def _read_arguments(found: object, limits: Limits) -> Union[Mapping[str, Any], List[Any]]:
    if found is None:
        return NO_FIELDS
    if isinstance(found, (dict, list)):
        return found
    raise ProtocolError(f"found {shown(found)}, allowed is a mapping or a list")


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
    """Returns (name, reader, whether it is required) per field."""
    defaults: Mapping[str, object] = operation._field_defaults
    return tuple((name, _READERS[_annotation(operation, name)], name not in defaults) for name in operation._fields)


def _annotation(operation: Type[Any], name: str) -> str:
    annotation = operation.__annotations__[name]
    return str(getattr(annotation, "__forward_arg__", annotation))


_FIELDS = {name: _fields_of(operation) for name, operation in OPERATIONS.items()}


def read_operation(fields: Mapping[str, Any], limits: Limits) -> Operation:
    """Returns the operation that a decoded message holds.

    Raises:
        ProtocolError: an unknown operation, a field that is missing or of the wrong kind.
    """
    op = fields.get("op")
    found_id = fields.get("id")
    id = found_id if isinstance(found_id, (str, int)) else None  # noqa: A001 - the protocol's own word
    if not isinstance(op, str) or op not in _FIELDS:
        raise ProtocolError(f"unknown operation {shown(op)}, allowed are {', '.join(_FIELDS)}", id=id)
    values: Dict[str, object] = {}
    for name, read, required in _FIELDS[op]:
        if name in fields:
            try:
                values[name] = read(fields[name], limits)
            except ProtocolError as error:
                raise ProtocolError(f"{name}: {error.problem}", op, id) from None
        elif required:
            raise ProtocolError(f"the field {name} is missing", op, id)
    return OPERATIONS[op](**values)  # type: ignore[no-any-return]  # every class of OPERATIONS is one of Operation


def operation_fields(operation: Operation) -> Dict[str, Any]:
    """Returns an operation as it is written on the wire; fields that have their default are left out."""
    defaults = operation._field_defaults
    fields: Dict[str, Any] = {"op": _NAMES[type(operation)]}
    for name, value in zip(operation._fields, operation):
        if name not in defaults or name in _ALWAYS_WRITTEN or value != defaults[name]:
            fields[name] = {} if value is NO_FIELDS else value
    return fields


_ALWAYS_WRITTEN = ("values", "result", "args", "status")
"""Peers read these without asking whether they are there."""


def decode(data: Wire, limits: Limits) -> Dict[str, Any]:
    """Returns the mapping in a JSON text, in UTF-8 bytes of it, or in CBOR bytes.

    Raises:
        ProtocolError: it is none of these, too long or nested too deeply.
    """
    if len(data) > limits.message_bytes:
        raise ProtocolError(f"the message is longer than {limits.message_bytes} bytes")
    if isinstance(data, bytes) and data[:1] not in _JSON_STARTS:
        decoded = decode_cbor(data, limits)
    else:
        decoded = _decode_json(data, limits)
    if not isinstance(decoded, dict):
        raise ProtocolError(f"the message is {shown(decoded)}, allowed is a mapping")
    return decoded


_JSON_STARTS = (b"{", b" ", b"\t", b"\r", b"\n")
"""First bytes of a JSON object; a CBOR map starts with none of them."""


def _decode_json(data: Wire, limits: Limits) -> object:
    def whole_number(digits: str) -> int:
        if len(digits) > limits.integer_digits:
            raise ProtocolError(f"a number has more than {limits.integer_digits} digits")
        return int(digits)

    try:
        text = data.decode("utf-8") if isinstance(data, bytes) else data
        if _nesting_bound(text) <= limits.nesting:
            return json.loads(text, parse_int=whole_number)
        decoded = json.loads(text, parse_int=whole_number)
    except ProtocolError:
        raise
    except RecursionError:
        raise ProtocolError(f"the message is nested more than {limits.nesting} deep") from None
    except UnicodeDecodeError:
        raise ProtocolError("the message is not UTF-8") from None
    except ValueError as error:
        raise ProtocolError(f"the message is not JSON: {error}") from None
    if isinstance(decoded, (dict, list)):
        _check_nesting(decoded, limits.nesting)
    return decoded


def _nesting_bound(text: str) -> int:
    """Returns a number that the nesting of a JSON text cannot exceed, for the cost of counting brackets."""
    return text.count("{") + text.count("[")


def _check_nesting(value: object, deepest: int) -> None:
    level: List[Any] = [value]
    for _ in range(deepest):
        level = [
            child
            for container in level
            for child in (container.values() if isinstance(container, dict) else container)
            if isinstance(child, (dict, list))
        ]
        if not level:
            return
    raise ProtocolError(f"the message is nested more than {deepest} deep")


def encode_json(value: object) -> str:
    """Returns compact JSON; NaN and infinities become null, as rosbridge has it, and bytes base64."""
    try:
        return _STRICT_JSON.encode(value)
    except ValueError:
        return _STRICT_JSON.encode(_without_infinities(value))


def _base64(value: object) -> str:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode("ascii")
    raise TypeError(f"{type(value).__name__} has no form in JSON")


_STRICT_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), default=_base64)
_LOOSE_JSON = json.JSONEncoder(allow_nan=True, separators=(",", ":"), default=_base64)


def _without_infinities(value: object) -> object:
    if isinstance(value, float):
        return value if -_INFINITY < value < _INFINITY else None
    if isinstance(value, dict):
        return {key: _without_infinities(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_infinities(item) for item in value]
    return value


_INFINITY = float("inf")


class Connection:
    """The protocol's state towards one peer."""

    def __init__(self, limits: Limits = DEFAULT_LIMITS, *, nan_as_null: bool = True) -> None:
        """Makes the state of a new connection.

        Args:
            limits: what the peer may send.
            nan_as_null: write NaN and infinities as null, which every JSON reader accepts. False writes them as
                Python does (`NaN`, `Infinity`), which rosbridge servers read and which loses nothing.
        """
        self.limits = limits
        self._reassembly = Reassembly(limits)
        self._fragment_ids = itertools.count()
        self._encode: Callable[[object], str] = encode_json if nan_as_null else _LOOSE_JSON.encode

    def receive(self, data: Wire, now_s: float) -> Optional[Operation]:
        """Takes one message of the peer.

        Args:
            data: the message.
            now_s: the time, in s, by which incomplete messages grow old.

        Returns:
            The operation in it; None when it was a fragment and others are missing.

        Raises:
            ProtocolError: it is not rosbridge, or beyond the limits. The connection can go on.
        """
        fields = decode(data, self.limits)
        for _ in range(_MOST_WRAPPINGS):
            op = fields.get("op")
            if op == "fragment" or (op == "png" and "num" in fields):
                whole = self._reassembly.add(fields, now_s)
                if whole is None:
                    return None
                if op == "png":
                    whole = decode_png(whole, self.limits.message_bytes)
            elif op == "png":
                found = fields.get("data")
                if not isinstance(found, str):
                    raise ProtocolError(f"data: found {shown(found)}, allowed is a text", "png")
                whole = decode_png(found, self.limits.message_bytes)
            else:
                return read_operation(fields, self.limits)
            fields = decode(whole, self.limits)
        raise ProtocolError("fragments and pictures are wrapped into one another too often")

    def send(
        self, operation: Operation, *, fragment_size: Optional[int] = None, compression: str = "none"
    ) -> List[Wire]:
        """Returns what to transmit for an operation.

        Args:
            operation: what to say.
            fragment_size: split what is longer, in characters; None: never.
            compression: one of COMPRESSIONS, as the peer asked for it. CBOR is not split.
        """
        fields = operation_fields(operation)
        if compression in ("cbor", "cbor-raw"):
            return [encode_cbor(fields)]
        text = self._encode(fields)
        if compression == "png":
            text = self._encode({"op": "png", "data": encode_png(text)})
        return self.fragmented(text, fragment_size)

    def fragmented(self, text: str, fragment_size: Optional[int]) -> List[Wire]:
        """Returns an encoded message as it is, or as fragments when it is longer than `fragment_size`."""
        if fragment_size is None or len(text) <= fragment_size:
            return [text]
        id = f"fragment:{next(self._fragment_ids)}"  # noqa: A001 - the protocol's own word
        return [self._encode(fragment) for fragment in split(text, fragment_size, id)]


_MOST_WRAPPINGS = 4
"""A fragmented picture of a fragmented message would be 3; more is somebody playing."""
