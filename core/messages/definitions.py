"""Definitions of message types: the formats .msg and .idl, parsed with bounded work.

Definitions may come from anyone. The grammars of rosbags try every alternative again at each level, so that a line of
nested brackets takes hours, and it evaluates constants. Here a text is read once from its start to its end, and
constants are not evaluated: only an array's size can depend on one, which must be a plain number then.

Sources: wiki.ros.org/msg; design.ros2.org/articles/idl_interface_definition.html.
"""

from __future__ import annotations

import re
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..values import canonical_type, number_of_text

SEQUENCE = -1
"""The size of an array of any length."""

LONGEST_TEXT = 1_000_000
"""Characters of a definition with the types in it; the largest ones of ROS have about 50,000."""
MOST_FIELDS = 5_000
"""Fields of all types in a definition."""
LARGEST_SIZE = 1 << 31
"""Elements of an array."""

NUMBERS: Mapping[str, str] = {
    "bool": "?", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q",
    "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""struct's letter for each type of fixed size."""

ROS1_KINDS: Mapping[str, str] = {"byte": "int8", "char": "uint8"}
"""Types of .msg that are numbers by another name, in ROS 1."""

TEXTS = ("string", "wstring")

_SEPARATOR = re.compile(r"^={80}\n", re.M)
_MSG_FIELD = re.compile(
    r"(?:@\w+\s+)?(?P<kind>[A-Za-z][\w/]{0,200})(?:<=\d{1,10})?(?:\[(?:(?P<size>\d{1,10})|<=\d{1,10})?(?P<array>\]))?"
    r"\s+(?P<name>[A-Za-z_]\w{0,200})(?P<constant>\s*=.*)?(?:\s.*)?"
)
_STRING_CONSTANT = re.compile(r"w?string(?:<=\d+)?\s+\w+\s*=")
_AS_SPELT: Mapping[str, str] = {}
_MSG_ALIASES = {
    "char": "uint8", "time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration",
}  # fmt: skip
_IDL_LEFT_OUT = re.compile(
    r"//[^\n]*|#[^\n]*|/\*.*?(?:\*/|\Z)|(?P<text>\"(?:[^\"\\]|\\.)*(?:\"|\Z)|'(?:[^'\\]|\\.)*(?:'|\Z))", re.S
)
"""Comments and directives; texts, which may contain anything."""
_IDL_ANNOTATION = re.compile(r"@[\w:]+\s*(?:\((?:[^()]|\((?:[^()]|\([^()]*\))*\))*\))?")
_IDL_STATEMENT = re.compile(
    r"(?:module\s+(?P<module>\w{1,200})\s*\{"
    r"|struct\s+(?P<struct>\w{1,200})\s*\{(?P<fields>(?:[^{};]*;)*)\s*\}"
    r"|enum\s+(?P<enum>\w{1,200})\s*\{[^{}]*\}"
    r"|typedef\s(?P<typedef>[^{};]*);"
    r"|const\s+(?P<constant>[^{};=]*\w)\s*=(?P<value>[^{};]*);"
    r"|(?P<end>\}))[\s;]*"
)
"""Of a text without annotations, texts and comments."""
_IDL_DECLARATOR = r"(\w{1,200})(?:\[(?:\w+::)*(\w+)\])?"
_IDL_DECLARATION = re.compile(
    r"(?:sequence<(?P<element>w?string<[^<>]*>|[\w: ]{1,200})(?:,[^<>]*)?>|(?P<one>w?string<[^<>]*>|[\w: ]{1,200} ))"
    rf"(?P<names>{_IDL_DECLARATOR}(?:,{_IDL_DECLARATOR})*)"
)
"""Of a text without spaces but between words."""
_IDL_NUMBERS = {
    "boolean": "bool", "octet": "uint8", "char": "uint8", "float": "float32", "double": "float64", "short": "int16",
    "unsigned short": "uint16", "long": "int32", "unsigned long": "uint32", "long long": "int64",
    "unsigned long long": "uint64", **{name: name for name in NUMBERS if "int" in name},
}  # fmt: skip
_PLAIN_KINDS = frozenset([*NUMBERS, *TEXTS, *ROS1_KINDS, "time", "duration"])
_DEEPEST = 32
"""Modules in one another."""


class Field(NamedTuple):
    """One field of a message."""

    name: str
    kind: str
    """A key of `NUMBERS`, one of `TEXTS`, or a type `package/Type`. `parse_msg` keeps byte, char, time and duration."""
    size: Optional[int] = None
    """None for one value, `SEQUENCE` for an array of any length, else the length of the array."""
    most: Optional[int] = None
    """Largest number of elements of a bounded array, where it is known."""


class Definition(NamedTuple):
    """One message type."""

    fields: Sequence[Field]
    constants: Sequence[Tuple[str, str]] = ()
    """Name and value, as text, of each constant."""

    @property
    def numbers(self) -> Mapping[str, float]:
        """The constants that are numbers; True is 1."""
        values = {name: number_of_text(text) for name, text in self.constants}
        return {name: number for name, number in values.items() if type(number) is float}


Definitions = Dict[str, Definition]
"""The definition of each type, by `package/Type`."""

TIMES: Definitions = {
    f"builtin_interfaces/{name}": Definition([Field("sec", "int32"), Field("nanosec", "uint32")])
    for name in ("Time", "Duration")
}
ROS1_TIMES: Definitions = {
    "builtin_interfaces/Time": Definition([Field("secs", "uint32"), Field("nsecs", "uint32")]),
    "builtin_interfaces/Duration": Definition([Field("secs", "int32"), Field("nsecs", "int32")]),
}
"""The types that ROS 1 has built in, under the names that they have in ROS 2."""

OTHER_NAMES: Mapping[str, str] = {"sec": "secs", "nanosec": "nsecs", "secs": "sec", "nsecs": "nanosec"}
"""The parts of a time in one version of ROS, and what they are named in the other."""


def parse_definition(type_name: str, text: str, form: str, *, is_ros1: bool = False) -> Definitions:
    """Returns the types in a definition: `type_name`, with which it begins, and those that it contains.

    `form` is the encoding of the text, such as `ros2msg` or `ros2idl`. Messages of ROS 1 have its times and its bytes,
    which are signed. Raises ValueError if the definition is not as the format requires, or too large.
    """
    if form.endswith("msg"):
        aliases = {**_MSG_ALIASES, "byte": "int8" if is_ros1 else "uint8"}
        types = parse_msg(type_name, text, aliases)
    else:
        types = {}
        for part in _parts(text if form.endswith("idl") else ""):
            first, _, rest = part.partition("\n")
            types.update(_Idl(rest if first.startswith("IDL: ") else part).types)
            _check_number_of_fields(types)
    if type_name not in types:
        raise ValueError("the definition does not define it")
    return {**(ROS1_TIMES if is_ros1 else TIMES), **types}


def parse_msg(type_name: str, text: str, aliases: Mapping[str, str] = _AS_SPELT) -> Definitions:
    """Returns the types in a definition in .msg, `type_name` first, whose plain kinds are as `aliases` say.

    Types without a package are looked for in the other packages too: a Header is that of std_msgs. Raises ValueError.
    """
    types: Definitions = {}
    name = type_name
    for number, part in enumerate(_parts(text)):
        if number:
            first, _, part = part.partition("\n")
            if not first.startswith("MSG: "):
                raise ValueError("expected a line MSG: after a separator")
            name = canonical_type(first[len("MSG: ") :].strip())
        types.setdefault(name, _msg_definition(name, part))
        _check_number_of_fields(types)
    by_name = {"Header": "std_msgs/Header", **{name.partition("/")[2]: name for name in types}}

    def resolved(field: Field) -> Field:
        kind = aliases.get(field.kind, field.kind)
        is_known = "/" not in kind or kind in types or kind in TIMES
        return field._replace(kind=kind if is_known else by_name.get(kind.partition("/")[2], kind))

    return {name: each._replace(fields=list(map(resolved, each.fields))) for name, each in types.items()}


def _parts(text: str) -> List[str]:
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"{len(text)} characters, expected at most {LONGEST_TEXT}")
    return _SEPARATOR.split(text)


def _check_number_of_fields(types: Definitions) -> None:
    if sum(len(definition.fields) for definition in types.values()) > MOST_FIELDS:
        raise ValueError(f"expected at most {MOST_FIELDS} fields, got more")


def _msg_definition(type_name: str, text: str) -> Definition:
    package = type_name.partition("/")[0]
    fields: List[Field] = []
    constants: List[Tuple[str, str]] = []
    for line in text.splitlines():
        line = line.strip()
        if _STRING_CONSTANT.match(line) is None:  # in which # is text
            line = line.partition("#")[0].strip()
        if not line:
            continue
        match = _MSG_FIELD.fullmatch(line)
        if match is None:
            raise ValueError(f"expected a field, got {line[:80]!r}")
        kind, name = match["kind"], match["name"]
        if match["constant"]:
            constants.append((name, match["constant"].partition("=")[2].strip()))
            continue
        if kind not in _PLAIN_KINDS:
            kind = canonical_type(kind) if "/" in kind else f"{package}/{kind}"
        size = None if not match["array"] else SEQUENCE if match["size"] is None else _size(match["size"])
        fields.append(Field(name, kind, size))
    return Definition(fields, constants)


def _size(text: str) -> int:
    if not text.isdecimal() or len(text) > 10 or int(text) > LARGEST_SIZE:
        raise ValueError(f"an array of {text[:80]} elements, expected a number up to {LARGEST_SIZE}")
    return int(text)


class _Idl:
    """The structs of one IDL text, read statement by statement."""

    def __init__(self, text: str) -> None:
        self.types: Definitions = {}
        self._aliases: dict[tuple[str, ...], tuple[str, int | None]] = {}
        """Kind and size of each typedef and enum, by its full name."""
        self._constants: dict[str, str] = {}
        self._scopes: list[str] = []
        constants_of: dict[str, list[tuple[str, str]]] = {}
        """Constants by the module that they are in: those of a struct `Log` are in `Log_Constants`."""
        plain = _IDL_ANNOTATION.sub(" ", _IDL_LEFT_OUT.sub(lambda match: '""' if match["text"] else " ", text)).strip()
        at = 0
        while at < len(plain):
            match = _IDL_STATEMENT.match(plain, at)
            if match is None or len(self._scopes) > _DEEPEST:
                raise ValueError(f"expected a module, struct, enum, typedef or const, got {plain[at : at + 80]!r}")
            at, what = match.end(), match.lastgroup
            if what == "module":
                self._scopes.append(match[what])
            elif what == "fields":
                name = match["struct"]
                constants = constants_of.get(f"{name}_Constants", ())
                self.types[f"{(*self._scopes, name)[0]}/{name}"] = Definition(self._declared(match[what]), constants)
            elif what == "enum":
                self._aliases.update({(*self._scopes, match[what]): ("uint32", None)})
            elif what == "typedef":
                fields = self._declared(match[what])
                self._aliases.update({(*self._scopes, name): (kind, size) for name, kind, size, _ in fields})
            elif what == "value":
                constant = match["constant"].split()[-1], re.sub(r"\s", "", match[what])
                self._constants.update([constant])
                constants_of.setdefault("".join(self._scopes[-1:]), []).append(constant)
            else:
                del self._scopes[-1:]
        if self._scopes:
            raise ValueError("the definition ends early")

    def _declared(self, text: str) -> list[Field]:
        """Returns what statements declare, each a type with the names that have it."""
        fields: list[Field] = []
        for statement in filter(str.strip, text.split(";")):
            statement = re.sub(r" ?(::|[\[\],<>]) ?", r"\1", " ".join(statement.split()))
            match = _IDL_DECLARATION.fullmatch(statement)
            if match is None:
                raise ValueError(f"expected a field, got {statement[:80]!r}")
            kind, size = self._kind_and_size(match["element"] or match["one"].strip())
            for name, length in re.findall(_IDL_DECLARATOR, match["names"]):
                own = _size(self._constants.get(length, length)) if length else None
                sizes = [each for each in (size, SEQUENCE if match["element"] else None, own) if each is not None]
                if len(sizes) > 1:
                    raise ValueError("expected an array with one dimension")
                fields.append(Field(name, kind, *sizes))
        return fields

    def _kind_and_size(self, text: str) -> tuple[str, int | None]:
        kind = text.partition("<")[0]
        if kind in TEXTS or kind in _IDL_NUMBERS:
            return _IDL_NUMBERS.get(kind, kind), None
        words = text.lstrip(":").split("::")
        for depth in range(len(self._scopes), -1, -1):
            alias = self._aliases.get((*self._scopes[:depth], *words))
            if alias is not None:
                return alias
        return f"{[*self._scopes, *words][0] if len(words) == 1 else words[0]}/{words[-1]}", None
