"""Binds a field path to the messages of a middleware: every name is looked up once, before the first message."""

from __future__ import annotations

import functools
import operator
from typing import Any, Callable, List, Mapping, NamedTuple, Sequence

from ..values.elements import NAME_ARRAYS, NOT_A_NUMBER, STATUS_TYPE, TIME_TYPES, DriverStatus, stamp_of
from ..values.field_path import Access, Every, Getter, Step, bind_steps, key_field, number_of_text
from .definitions import TEXTS
from .dialect import Dialect, FieldType

Reader = Callable[[FieldType], Getter]
"""Returns the native-to-mapping converter of a field."""


def as_it_is(value: Any) -> Any:
    """Returns the value unchanged: `Dialect.plain` where arrays are lists of Python's numbers."""
    return value


class BoundPath(NamedTuple):
    """A path in the messages of a class."""

    steps: Sequence[Step]
    """With the names of fields as the class has them."""
    found: FieldType
    """The type of what it leads to."""
    owner: Any
    """The class of the message that has the last named field."""
    is_fixed: bool
    """Whether that is an element of an array of fixed size."""


def check_path(dialect: Dialect, native_class: Any, path: Sequence[Step]) -> BoundPath:
    """Returns a path that is not empty, bound to a class; raises ValueError with the reason if there is none."""
    above = dialect.type_name(native_class)
    owner, is_fixed = native_class, False
    found = FieldType(above, above, native_class, is_array=not isinstance(path[0], str))
    siblings: Mapping[str, FieldType] = {}
    steps: List[Step] = []
    for step in path:
        if isinstance(step, str):
            siblings = {} if found.is_array or not found.message else dialect.field_types(found.message)
            step = step if step in siblings else dialect.other_names.get(step, step)
            if step not in siblings:
                there = f"has {', '.join(siblings)}" if siblings else "is a plain value or a list, without fields"
                raise ValueError(f"{above} {there}")
            owner, above, found, is_fixed = found.message, step, siblings[step], False
        else:
            if not found.is_array:
                raise ValueError(f"{above} is a {found.element}, not an array")
            if isinstance(step, int):
                if found.size is not None and step >= found.size:
                    raise ValueError(f"{above} has {found.size} elements, the last one is [{found.size - 1}]")
            elif step != Every() and not _has_names(dialect, found, above, siblings):
                raise ValueError(f"the elements of {above} have no name and no key")
            above, siblings, is_fixed = f"an element of {above}", {}, found.size is not None
            found = FieldType(found.element, found.kind, found.message)
        steps.append(step)
    return BoundPath(steps, found, owner, is_fixed)


def _has_names(dialect: Dialect, found: FieldType, array: str, siblings: Mapping[str, FieldType]) -> bool:
    """Returns whether the elements of an array have names of their own, or in an array beside it."""
    if found.message and key_field(dialect.field_types(found.message)):
        return True
    beside = (siblings[name] for name in NAME_ARRAYS if name in siblings and name != array)
    return any(each.is_array and each.kind in TEXTS for each in beside)


def bind_path(dialect: Dialect, reader: Reader, native_class: Any, path: Sequence[Step]) -> Getter:
    """Returns a function that reads a path that is not empty; raises ValueError with the reason if there is none."""
    bound = check_path(dialect, native_class, path)
    finish = _finish(dialect, reader, bound)
    names = [step for step in bound.steps if isinstance(step, str)]
    if len(names) < len(bound.steps):
        return bind_steps(bound.steps, Access(getattr, _fields_by(dialect), as_it_is), finish)
    read = operator.attrgetter(".".join(names))
    return read if finish is as_it_is else lambda message: finish(read(message))


def _fields_by(dialect: Dialect) -> Callable[[Any], Mapping[str, Any]]:
    """Returns a function that returns the fields of a native message; empty for other values."""

    @functools.lru_cache(maxsize=None)
    def fields_of(native_class: Any) -> Mapping[str, Any]:
        try:
            return dialect.field_types(native_class)
        except AttributeError:
            return {}

    return lambda value: fields_of(value.__class__)


def _finish(dialect: Dialect, reader: Reader, bound: BoundPath) -> Getter:
    """Returns a function that returns the value of what a path leads to."""
    found = bound.found
    if found.message and not found.is_array:
        types = dialect.field_types(found.message)
        if found.element in TIME_TYPES:
            parts = operator.attrgetter(*tuple(types)[:2])
            return lambda time: stamp_of(*parts(time))
        if found.element == STATUS_TYPE:
            level = reader(types["level"])
            return lambda status: DriverStatus(level(status.level), status.message)
        if not isinstance(bound.steps[-1], str) and "key" in types and "value" in types:
            return lambda pair: number_of_text(pair.value)
    if (found.message or found.is_array) and any(isinstance(step, Every) for step in bound.steps):
        return lambda value: NOT_A_NUMBER
    read = reader(found)
    return (lambda value: read(dialect.plain(value))) if bound.is_fixed else read
