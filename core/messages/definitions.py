"""Definitions of message types: the formats .msg and .idl, parsed with bounded work.

Definitions may come from anyone. The grammars of rosbags try every alternative again at each level, so that a line of
nested brackets takes hours, and it evaluates constants. Here a text is read once from its start to its end, and
constants are not evaluated: only an array's size can depend on one, which must be a plain number then.

Sources: wiki.ros.org/msg; design.ros2.org/articles/idl_interface_definition.html.
"""

from __future__ import annotations

import re
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..values.field_path import number_of_text
from ..values.names import canonical_type

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
_MSG_ALIASES = {
    "char": "uint8", "time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration",
}  # fmt: skip
_IDL_TOKEN = (
    r"(?:\s+|//[^\n]*|/\*.*?\*/|#[^\n]*)|"
    r"(?P<word>[A-Za-z_]\w{0,200}|\d[\w.+-]{0,40}|::|[{}()\[\]<>;,=@+\-*/%|&^~.])"
    r'|(?P<text>"(?:[^"\\]|\\.)*"|\'(?:[^\'\\]|\\.)*\')'
)
"""Compiled when it is used: nodes need no IDL."""
_IDL_NUMBERS = {
    "boolean": "bool", "octet": "uint8", "char": "uint8", "float": "float32", "double": "float64", "short": "int16",
    "unsigned short": "uint16", "long": "int32", "unsigned long": "uint32", "long long": "int64",
    "unsigned long long": "uint64", **{name: name for name in NUMBERS if "int" in name},
}  # fmt: skip
_PLAIN_KINDS = frozenset([*NUMBERS, *TEXTS, *ROS1_KINDS, "time", "duration"])
_LONG_WORDS = ("unsigned", "long", "short")


class Field(NamedTuple):
    """One field of a message."""

    name: str
    kind: str
    """A key of `NUMBERS`, one of `TEXTS`, or a type `package/Type`. `parse_msg` keeps byte, char, time and duration."""
    size: Optional[int]
    """None: one value; `SEQUENCE`: an array of any length; else the length of the array."""


class Definition(NamedTuple):
    """One message type."""

    fields: Sequence[Field]
    constants: Sequence[Tuple[str, str]] = ()
    """Name and value, as text, of each constant."""

    @property
    def numbers(self) -> Mapping[str, float]:
        """The constants that are numbers; True is 1."""
        found = {name: number_of_text(text) for name, text in self.constants}
        return {name: number for name, number in found.items() if type(number) is float}


Definitions = Dict[str, Definition]
"""The definition of each type, by `package/Type`."""

TIMES: Definitions = {
    f"builtin_interfaces/{name}": Definition([Field("sec", "int32", None), Field("nanosec", "uint32", None)])
    for name in ("Time", "Duration")
}
"""The types that ROS 1 has built in, under the names that they have in ROS 2."""


def parse_definition(type_name: str, text: str, form: str, byte: str = "uint8") -> Definitions:
    """Returns the types in a definition: `type_name`, with which it begins, and those that it contains.

    `form` is `msg` or `idl`; `byte` is the type that `byte` stands for in .msg. Raises ValueError if the definition is
    not as the format requires, or too large.
    """
    if form == "msg":
        aliases = {**_MSG_ALIASES, "byte": byte}
        found = _with_kinds(parse_msg(type_name, text), lambda kind: aliases.get(kind, kind))
    else:
        found = {}
        for part in _parts(text):
            first, _, rest = part.partition("\n")
            found.update(_Idl(rest if first.startswith("IDL: ") else part).types)
            _check_number_of_fields(found)
    if type_name not in found:
        raise ValueError("the definition does not define it")
    return {**TIMES, **found}


def parse_msg(type_name: str, text: str) -> Definitions:
    """Returns the types in a definition in .msg, `type_name` first, with kinds as spelt there; raises ValueError."""
    found: Definitions = {}
    name = type_name
    for number, part in enumerate(_parts(text)):
        if number:
            first, _, part = part.partition("\n")
            if not first.startswith("MSG: "):
                raise ValueError("expected a line MSG: after a separator")
            name = canonical_type(first[len("MSG: ") :].strip())
        found.setdefault(name, _msg_definition(name, part))
        _check_number_of_fields(found)
    return _resolved(found)


def _parts(text: str) -> List[str]:
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"{len(text)} characters, expected at most {LONGEST_TEXT}")
    return _SEPARATOR.split(text)


def _check_number_of_fields(found: Definitions) -> None:
    if sum(len(definition.fields) for definition in found.values()) > MOST_FIELDS:
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
        found = _MSG_FIELD.fullmatch(line)
        if found is None:
            raise ValueError(f"expected a field, got {line[:80]!r}")
        kind, name = found["kind"], found["name"]
        if found["constant"]:
            constants.append((name, found["constant"].partition("=")[2].strip()))
            continue
        if kind not in _PLAIN_KINDS:
            kind = canonical_type(kind) if "/" in kind else f"{package}/{kind}"
        size = None if not found["array"] else SEQUENCE if found["size"] is None else _size(found["size"])
        fields.append(Field(name, kind, size))
    return Definition(fields, constants)


def _resolved(types: Definitions) -> Definitions:
    """Looks for types without a package in the other packages too: a Header is that of std_msgs."""
    by_name = {"Header": "std_msgs/Header", **{name.partition("/")[2]: name for name in types}}

    def resolve(kind: str) -> str:
        is_known = "/" not in kind or kind in types or kind in TIMES
        return kind if is_known else by_name.get(kind.partition("/")[2], kind)

    return _with_kinds(types, resolve)


def _with_kinds(types: Definitions, kind_of: Callable[[str], str]) -> Definitions:
    return {
        name: definition._replace(fields=[field._replace(kind=kind_of(field.kind)) for field in definition.fields])
        for name, definition in types.items()
    }


def _size(digits: str) -> int:
    number = int(digits)
    if number > LARGEST_SIZE:
        raise ValueError(f"an array of {number} elements, expected at most {LARGEST_SIZE}")
    return number


class _Idl:
    """The structs of one IDL text."""

    def __init__(self, text: str) -> None:
        self.types: Definitions = {}
        self._tokens = _idl_tokens(text)
        self._at = 0
        self._aliases: Dict[Tuple[str, ...], Tuple[str, Optional[int]]] = {}
        """Kind and size of each typedef and enum, by its full name."""
        self._constants: Dict[str, int] = {}
        self._constants_of: Dict[str, List[Tuple[str, str]]] = {}
        """Those of each type, by the name of their module: `Log_Constants`."""
        self._modules: List[str] = []
        while self._at < len(self._tokens):
            self._read_definition()
        if self._modules:
            raise ValueError("a module does not end")

    def _read_definition(self) -> None:
        self._skip_annotations()
        word = self._next()
        if word == "module":
            self._modules.append(self._next())
            self._expect("{")
        elif word == "}" and self._modules:
            self._modules.pop()
            self._expect(";")
        elif word == "struct":
            self._read_struct()
        elif word == "const":
            self._read_constant()
        elif word == "typedef":
            kind, size = self._read_type()
            for name, own in self._read_declarators():
                self._aliases.update({(*self._modules, name): (kind, _only_one(size, own))})
        elif word == "enum":
            self._aliases.update({(*self._modules, self._next()): ("uint32", None)})
            self._skip_through("}")
            self._expect(";")
        else:
            raise ValueError(f"expected a module, struct, const, typedef or enum, got {word[:80]!r}")

    def _read_struct(self) -> None:
        name, fields = self._next(), []
        self._expect("{")
        self._skip_annotations()
        while not self._accept("}"):
            kind, size = self._read_type()
            fields += [Field(field, kind, _only_one(size, own)) for field, own in self._read_declarators()]
            self._skip_annotations()
        self._expect(";")
        constants = self._constants_of.get(f"{name}_Constants", ())
        self.types[f"{(*self._modules, name)[0]}/{name}"] = Definition(fields, constants)

    def _read_constant(self) -> None:
        start = self._at
        self._skip_through(";")
        words = self._tokens[start : self._at - 1]
        if self._modules and "=" in words[1:]:
            at = words.index("=", 1)
            self._constants_of.setdefault(self._modules[-1], []).append((words[at - 1], "".join(words[at + 1 :])))
        if len(words) > 3 and words[-2] == "=" and words[-1].isdecimal():
            self._constants[words[-3]] = _size(words[-1])

    def _read_type(self) -> Tuple[str, Optional[int]]:
        if not self._accept("sequence"):
            return self._read_element()
        self._expect("<")
        kind, size = self._read_element()
        if self._accept(","):
            self._read_size()
        self._expect(">")
        return kind, _only_one(size, SEQUENCE)

    def _read_element(self) -> Tuple[str, Optional[int]]:
        words = [self._next()]
        if words[0] in TEXTS:
            if self._accept("<"):
                self._read_size()
                self._expect(">")
            return words[0], None
        while words[-1] in _LONG_WORDS and self._peek() in _LONG_WORDS and len(words) < 3:
            words.append(self._next())
        if " ".join(words) in _IDL_NUMBERS:
            return _IDL_NUMBERS[" ".join(words)], None
        if words == ["::"]:
            words = [self._next()]
        while self._accept("::"):
            words.append(self._next())
        for depth in range(len(self._modules), -1, -1):
            alias = self._aliases.get((*self._modules[:depth], *words))
            if alias is not None:
                return alias
        return f"{[*self._modules, *words][0] if len(words) == 1 else words[0]}/{words[-1]}", None

    def _read_declarators(self) -> List[Tuple[str, Optional[int]]]:
        found = []
        while True:
            name, size = self._next(), None
            if not name.isidentifier():
                raise ValueError(f"expected a name, got {name[:80]!r}")
            if self._accept("["):
                size = self._read_size()
                self._expect("]")
            found.append((name, size))
            if not self._accept(","):
                self._expect(";")
                return found

    def _read_size(self) -> int:
        """Reads a number or the name of a constant."""
        word = self._next()
        while self._accept("::"):
            word = self._next()
        if word.isdecimal():
            return _size(word)
        if word not in self._constants:
            raise ValueError(f"expected a number or a constant that is one, got {word[:80]!r}")
        return self._constants[word]

    def _skip_annotations(self) -> None:
        while self._accept("@"):
            self._at += 1
            while self._accept("::"):
                self._at += 1
            depth = 0
            while depth or self._peek() == "(":
                word = self._next()
                depth += (word == "(") - (word == ")")

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self) -> str:
        word = self._peek()
        if not word:
            raise ValueError("the definition ends early")
        self._at += 1
        return word

    def _skip_through(self, word: str) -> None:
        while self._next() != word:
            pass

    def _accept(self, word: str) -> bool:
        """Moves past a word if it is the next one; returns whether it is."""
        is_next = self._peek() == word
        self._at += is_next
        return is_next

    def _expect(self, word: str) -> None:
        found = self._next()
        if found != word:
            raise ValueError(f"expected {word!r}, got {found[:80]!r}")


def _only_one(size: Optional[int], own: Optional[int]) -> Optional[int]:
    """Returns the size of a type or of its declarator; both would be an array of arrays."""
    if size is not None and own is not None:
        raise ValueError("expected an array with one dimension")
    return size if own is None else own


def _idl_tokens(text: str) -> List[str]:
    match = re.compile(_IDL_TOKEN, re.S).match
    tokens: List[str] = []
    at = 0
    while at < len(text):
        found = match(text, at)
        if found is None or found.end() == at or (text.startswith("/*", at) and found["word"]):
            raise ValueError(f"not IDL: {text[at : at + 80]!r}")
        if found["word"] or found["text"]:
            tokens.append(found["word"] or '"')
        at = found.end()
    return tokens
