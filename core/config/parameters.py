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
from functools import cached_property, partial
from typing import Any, Callable, Iterable, Iterator, Mapping

from ..values import ConfigError, JsonObject, Level, Path, describe, list_text

_NOUNS: Mapping[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "printable text",
    (int, str): "a whole number or a text",
    (float, str): "a number or a text",
    list: "a list of numbers",
    tuple: "a list of texts",
    dict: "a mapping",
    (dict, list): "a mapping or a list",
    object: "a value",
    datetime.datetime: "a time such as 2026-11-22T05:00:00Z",
}
MOST_SHOWN = 12
"""Choices and keys that a message names."""

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
    or a whole number is `(int, str)`, a number or a text `(float, str)`, a mapping or a list `(dict, list)`."""
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
            return "one of " + list_text([choice or "nothing" for choice in choices], MOST_SHOWN)
        noun = "a text" if self.any_text and self.kind is str else _NOUNS[self.kind]
        low, high = (None if limit is None else f"{limit:.15g}" for limit in (self.minimum, self.maximum))
        if self.kind is tuple:
            return f"{noun} that are not empty" if low else noun
        if self.kind in (str, (int, str)):
            return f"{noun} of {low or 'at most'}{' to' if low else ''} {high} characters" if high else noun
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
        return partial(_CONVERTERS.get(self.kind, _scalar), self)

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


def _scalar(parameter: Parameter, given: Any) -> Any:
    """Returns a number or a text, of a kind that may be either of them; None if it is not allowed.

    The limits are those of the text if it may be one.
    """
    kinds = parameter.kind if isinstance(parameter.kind, tuple) else (parameter.kind,)
    low, high = parameter.minimum, parameter.maximum
    if isinstance(given, str):
        is_printable = parameter.any_text or kinds != (str,) or given.isprintable()
        is_allowed = is_printable and (high is None or len(given) <= high) and (not low or given.strip())
        return given if str in kinds and (given in parameter.choices if parameter.choices else is_allowed) else None
    if isinstance(given, bool) or not isinstance(given, (int, float)) or not abs(given) <= sys.float_info.max:
        return None
    if str not in kinds and ((low is not None and given < low) or (high is not None and given > high)):
        return None
    if float in kinds:
        return float(given)
    is_whole = isinstance(given, int) or (str not in kinds and int(given) == given)
    return int(given) if int in kinds and is_whole else None


def _list(parameter: Parameter, given: Any) -> tuple[Any, ...] | None:
    if isinstance(given, (str, bytes, Mapping)) or not isinstance(given, Iterable):
        return None
    items = tuple(map(replace(parameter, kind=str if parameter.kind is tuple else float).convert, given))
    return None if None in items else items


def _level(parameter: Parameter, given: Any) -> Level | None:
    return Level[given] if isinstance(given, str) and given in (parameter.choices or Level.__members__) else None


def _time(parameter: Parameter, given: Any) -> datetime.datetime | None:
    try:
        time = datetime.datetime.fromisoformat(given.replace("Z", "+00:00"))
        return time if time.tzinfo else time.replace(tzinfo=datetime.timezone.utc)
    except (ValueError, AttributeError, TypeError):
        return None


def _instance(types: Any) -> Callable[[Parameter, Any], Any]:
    return lambda parameter, given: given if isinstance(given, types) else None


_CONVERTERS: Mapping[Any, Callable[[Parameter, Any], Any]] = {
    bool: _instance(bool),
    list: _list,
    tuple: _list,
    Level: _level,
    datetime.datetime: _time,
    dict: _instance((dict, Mapping)),
    (dict, list): _instance((dict, list, Mapping)),
    object: _instance(object),
}
"""What converts values of a kind; the others are scalars."""


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
