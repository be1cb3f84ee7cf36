"""One key of what comes from outside, and tables of them: they validate, and describe ROS parameters and documents.

A configuration is a nested mapping, as in the file under `ros__parameters`. `read_parameters` checks one level of it
against a table and returns plain values. Every mistake is a ConfigError with the key's path. `schema` makes such tables
of dataclasses.
"""

from __future__ import annotations

import datetime
import math
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Callable, Iterable, Iterator, List, Mapping, Sequence, Union

from ..values import ConfigError, JsonObject, Level, Path, Problems, describe, list_text

_Identifier = Union[str, int]
_Datum = Union[float, str]
_Container = Union[JsonObject, List[Any]]
_ALLOWED: Mapping[Any, str] = {
    bool: "true or false",
    list: "a list of numbers",
    dict: "a mapping",
    object: "a value",
    _Container: "a mapping or a list",
    _Datum: "a number or a text",
    datetime.datetime: "a time such as 2026-11-22T05:00:00Z",
}
_MOST_SHOWN = 12
"""Choices and keys that a message names."""
_ELEMENT_KINDS: Mapping[type, type] = {list: float, tuple: str}

Convert = Callable[[Any], Any]
"""Returns a value of a kind, None if it is given something else."""


@dataclass(frozen=True)
class Parameter:
    """One key: its meaning and its allowed values."""

    name: str
    """Key; a dotted path below the node when it is declared to a middleware."""
    kind: Any
    """bool, int, float, str, `Level` (read from its name) or datetime (ISO 8601; UTC unless it has a time zone).

    list is a list of numbers, tuple one of texts; both are read as tuples. dict is any mapping, object anything. A text
    or a whole number is `Union[str, int]`, a number or a text `Union[float, str]`, a mapping or a list
    `Union[JsonObject, List[Any]]`."""
    default: Any
    """Value if the key is left out; None if there is no value and the feature is disabled."""
    description: str
    """One line, with the unit."""
    minimum: float | None = None
    """Of a text, and of each text of a list: 1 if it must not be blank."""
    maximum: float | None = None
    """Of a text: the number of its characters."""
    choices: tuple[str, ...] = ()
    """The allowed texts; empty if any text is allowed."""
    any_text: bool = False
    """Whether texts may have control characters, which break the lines that contain them."""
    is_path: bool = False
    """Whether it is the path of a file, relative to the folder of the configuration."""
    is_secret: bool = False
    """Whether messages must not show the value."""
    is_required: bool = False
    """Whether it must be given."""
    field: str = ""
    """Name of its field, if it is one of a dataclass."""

    def below(self, prefix: str, **changes: Any) -> Parameter:
        """Returns this parameter of the section `prefix`, by its dotted path; `changes` are fields to replace."""
        return replace(self, name=f"{prefix}.{self.name}", **changes)

    @property
    def allowed(self) -> str:
        """The allowed values, in words."""
        choices = self.choices or (tuple(Level.__members__) if self.kind is Level else ())
        if choices:
            return "one of " + list_text([choice or "nothing" for choice in choices], _MOST_SHOWN)
        if self.kind in _ALLOWED:
            return _ALLOWED[self.kind]
        low, high = (None if limit is None else f"{limit:.15g}" for limit in (self.minimum, self.maximum))
        if self.kind is tuple:
            return "a list of texts that are not empty" if low else "a list of texts"
        if self.kind in (str, _Identifier):
            noun = (
                "a whole number or a text" if self.kind is not str else "a text" if self.any_text else "printable text"
            )
            return f"{noun} of {low or 'at most'}{' to' if low else ''} {high} characters" if high else noun
        noun = "a whole number" if self.kind is int else "a number"
        if low and high:
            return f"{noun} from {low} to {high}"
        return f"{noun} of at least {low}" if low else f"{noun} of at most {high}" if high else noun

    def read(self, given: object, path: Path = ()) -> Any:
        """Returns `given` as this parameter's kind; raises ConfigError if it is not of this kind and range, and finite.

        A whole number is accepted as a float, such as YAML's `20` for a bound.
        """
        value = self.convert(given)
        if value is None and self.kind is not object:
            raise ConfigError(self.refusal(given), path)
        return value

    def refusal(self, given: object) -> str:
        """Returns what was expected in place of a value that is not allowed."""
        got = "something else" if self.is_secret else f"{describe(given)}{self._hint(given)}"
        return f"expected {self.allowed}, got {got}"

    @cached_property
    def convert(self) -> Convert:
        """Returns its argument as a value of this kind, None if it is not allowed."""
        return CONVERTERS[self.kind](self)

    def _hint(self, given: object) -> str:
        if isinstance(given, str) and self.kind in (int, float) and len(given) < 40:
            try:
                number = float(given)
            except ValueError:
                return ""
            return f"; YAML reads this as text, write {number!r}" if math.isfinite(number) else ""
        if self.kind is str and not self.choices and isinstance(given, (bool, int, float, datetime.date)):
            return "; quote it"
        return ""


def _number(parameter: Parameter) -> Convert:
    largest = sys.float_info.max
    low = -largest if parameter.minimum is None else parameter.minimum
    high = largest if parameter.maximum is None else parameter.maximum
    is_whole = parameter.kind is int

    def convert(given: Any) -> float | None:
        if isinstance(given, bool) or not isinstance(given, (int, float)) or not low <= given <= high:
            return None
        if not is_whole:
            return float(given)
        return int(given) if int(given) == given else None

    return convert


def _text(parameter: Parameter) -> Convert:
    choices, any_text, may_be_blank = parameter.choices, parameter.any_text, not parameter.minimum
    most = sys.maxsize if parameter.maximum is None else parameter.maximum
    if choices:
        return lambda given: given if isinstance(given, str) and given in choices else None

    def convert(given: Any) -> str | None:
        if not isinstance(given, str) or len(given) > most or not (any_text or given.isprintable()):
            return None
        return given if may_be_blank or (given and not given.isspace()) else None

    return convert


def _identifier(parameter: Parameter) -> Convert:
    text = replace(parameter, kind=str, any_text=True).convert
    return lambda given: given if isinstance(given, int) and not isinstance(given, bool) else text(given)


def _datum(parameter: Parameter) -> Convert:
    number, text = (replace(parameter, kind=kind, any_text=True).convert for kind in (float, str))
    return lambda given: text(given) if isinstance(given, str) else number(given)


def _list(parameter: Parameter) -> Convert:
    element = replace(parameter, kind=_ELEMENT_KINDS[parameter.kind]).convert

    def convert(given: Any) -> tuple[Any, ...] | None:
        if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, Iterable):
            return None
        items = tuple(map(element, given))
        return None if None in items else items

    return convert


def _level(parameter: Parameter) -> Convert:
    names = parameter.choices or tuple(Level.__members__)
    return lambda given: Level[given] if isinstance(given, str) and given in names else None


def _time(given: Any) -> datetime.datetime | None:
    try:
        time = datetime.datetime.fromisoformat(given.replace("Z", "+00:00"))
        return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
    except (ValueError, AttributeError, TypeError):
        return None


CONVERTERS: Mapping[Any, Callable[[Parameter], Convert]] = {
    bool: lambda parameter: lambda given: given if isinstance(given, bool) else None,
    int: _number,
    float: _number,
    str: _text,
    list: _list,
    tuple: _list,
    Level: _level,
    datetime.datetime: lambda parameter: _time,
    dict: lambda parameter: lambda given: given if isinstance(given, (dict, Mapping)) else None,
    _Identifier: _identifier,
    _Datum: _datum,
    _Container: lambda parameter: lambda given: given if isinstance(given, (dict, list, Mapping)) else None,
    object: lambda parameter: lambda given: given,
}
"""What makes the function `convert` of a parameter, by its kind."""


def require_mapping(given: object, path: Path = ()) -> JsonObject:
    """Returns `given`, a mapping whose keys are all text; raises ConfigError if it is something else."""
    if not isinstance(given, Mapping):
        raise ConfigError(f"expected a mapping of keys to values, got {describe(given)}", path)
    problems = Problems()
    for key in given:
        if not isinstance(key, str):
            shown = describe(key)
            problems.add(ConfigError(f"expected text as a key, got {shown}; quote it", (*path, shown)))
    problems.raise_if_any()
    return given


def unknown_key(key: str, allowed: Sequence[str], path: Path = ()) -> ConfigError:
    """Returns the error for a key of the mapping at `path` that is not one of `allowed`, which its `details` lists."""
    import difflib  # only for mistakes: it takes memory in every node

    close = difflib.get_close_matches(key[:60], allowed, n=1)
    hint = f"did you mean {close[0]}?" if close else f"expected one of {list_text(list(allowed), _MOST_SHOWN)}"
    return ConfigError(f"unknown key; {hint}", (*path, key), details=f"the keys here: {', '.join(allowed)}")


def read_parameters(
    tree: JsonObject,
    parameters: Sequence[Parameter],
    path: Path = (),
    sections: Sequence[str] = (),
    problems: Problems | None = None,
) -> dict[str, Any]:
    """Reads one level of a configuration: the mapping at `path`.

    Returns a value per parameter; the default for a key that is left out. `sections` are keys of nested mappings, which
    are left to the caller. Raises ConfigError with all unknown keys and values that are not allowed, or adds them to
    `problems`, and returns the defaults for them.
    """
    known = {parameter.name: parameter for parameter in parameters}
    values = {name: parameter.default for name, parameter in known.items()}
    collected = Problems() if problems is None else problems
    for key, value in tree.items():
        if key in known:
            with collected:
                values[key] = known[key].read(value, (*path, key))
        elif key not in sections:
            collected.add(unknown_key(key, [*known, *sections], path))
    if problems is None:
        collected.raise_if_any()
    return values


def flatten(tree: JsonObject, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields (dotted name, value) for every leaf of a nested mapping: the form in which ROS 2 names parameters."""
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def unflatten(values: JsonObject) -> dict[str, Any]:
    """Nests dotted names, as the inverse of `flatten`; a name that is also the prefix of another is a ConfigError."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parents, leaf = name.split(".")
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
            if not isinstance(branch, dict):
                break
        if not isinstance(branch, dict) or leaf in branch:
            raise ConfigError("expected either a value or nested keys, got both", tuple(name.split(".")))
        branch[leaf] = value
    return tree
