"""Binds a field path to the messages of a middleware: every name is looked up once, before the first message."""

from __future__ import annotations

import operator
from typing import Any, Callable, List, Mapping, Optional, Sequence

from ..values.elements import (
    MOST_ELEMENTS,
    NAME_ARRAYS,
    NOT_A_NUMBER,
    STATUS_TYPE,
    TIME_TYPES,
    BadDatum,
    DriverStatus,
    is_own_status,
    stamp_of,
    unequal,
)
from ..values.field_path import (
    ABSENT,
    Every,
    Getter,
    Step,
    key_field,
    named_element,
    named_elements,
    number_of_text,
    numbered_elements,
)
from .definitions import TEXTS
from .dialect import Dialect, FieldType

Reader = Callable[[FieldType], Getter]
"""Returns the native-to-mapping converter of a field."""


def as_it_is(value: Any) -> Any:
    """Returns the value unchanged: `Dialect.plain` where arrays are lists of Python's numbers."""
    return value


def bind_path(dialect: Dialect, reader: Reader, native_class: Any, path: Sequence[Step]) -> Getter:
    """Returns a function that reads a path that is not empty; raises ValueError with the reason if there is none."""
    name = dialect.type_name(native_class)
    if isinstance(path[0], str):
        return _chain(_Binder(dialect, reader).bind(FieldType(name, name, native_class), name, path))
    get = _chain(_Binder(dialect, reader).bind(FieldType(name, name, native_class, is_array=True), name, path))
    return lambda message: get([message])


def owner_of(dialect: Dialect, native_class: Any, path: Sequence[Step]) -> Any:
    """Returns the class of the message that has the last named field of a path that can be bound."""
    owner = native_class
    for step in path:
        if isinstance(step, str):
            owner, types = native_class, dialect.field_types(native_class)
            native_class = types[step if step in types else dialect.other_names[step]].message
    return owner


class _Binder:
    """Binds paths to the types of one middleware."""

    def __init__(self, dialect: Dialect, reader: Reader) -> None:
        self._dialect = dialect
        self._reader = reader

    def bind(self, found: FieldType, above: str, path: Sequence[Step], *, is_element: bool = False) -> List[Getter]:
        """Returns the functions that read the steps of a path from a value of type `found`, `above` in errors."""
        steps: List[Getter] = []
        siblings: Mapping[str, FieldType] = {}
        for at, step in enumerate(path):
            if isinstance(step, str):
                siblings = {} if found.is_array or not found.message else self._dialect.field_types(found.message)
                above, found = self._field(step, above, siblings)
                steps.append(operator.attrgetter(above))
                continue
            if not found.is_array:
                raise ValueError(f"{above} is a {found.element}, not an array")
            element = FieldType(found.element, found.kind, found.message)
            if isinstance(step, Every):
                rest = self.bind(element, f"an element of {above}", path[at + 1 :], is_element=True)
                return self._several(steps, found, above, siblings, step, _chain(rest) if rest else None)
            if isinstance(step, int):
                if found.size is not None and step >= found.size:
                    raise ValueError(f"{above} has {found.size} elements, the last one is [{found.size - 1}]")
                steps.append(operator.itemgetter(step))
            else:
                steps = self._named(steps, found, above, siblings, step.key)
            if found.size is not None:
                steps.append(self._dialect.plain)
            above, found, siblings = f"an element of {above}", element, {}
        return [
            *steps,
            *self._value(found, is_selected=not path or not isinstance(path[-1], str), is_element=is_element),
        ]

    def _field(self, step: str, above: str, types: Mapping[str, FieldType]) -> Any:
        name = step if step in types else self._dialect.other_names.get(step, step)
        if name not in types:
            there = f"has {', '.join(types)}" if types else "is a plain value or a list, without fields"
            raise ValueError(f"{above} {there}")
        return name, types[name]

    def _own_name(self, found: FieldType) -> Optional[str]:
        """Returns the field with the name of an array's elements; None if they have none."""
        return key_field(self._dialect.field_types(found.message)) if found.message else None

    def _names_beside(self, above: str, siblings: Mapping[str, FieldType]) -> str:
        """Returns the field with the names of the elements of the array `above`, in an array beside it."""
        for name in NAME_ARRAYS:
            if name in siblings and name != above and siblings[name].is_array and siblings[name].kind in TEXTS:
                return name
        raise ValueError(f"the elements of {above} have no name and no key")

    def _named(
        self, steps: List[Getter], found: FieldType, above: str, siblings: Mapping[str, FieldType], key: str
    ) -> List[Getter]:
        """Returns the steps with that to the element with a name."""
        own = self._own_name(found)
        if own is not None:
            name_of = operator.attrgetter(own)
            return [*steps, lambda elements: next((each for each in elements if name_of(each) == key), ABSENT)]
        beside = self._names_beside(above, siblings)
        both = operator.attrgetter(above, beside)

        def get(message: Any) -> Any:
            elements, names = both(message)
            return named_element(elements, names, key, above, beside)

        return [*steps[:-1], get]

    def _several(
        self,
        steps: List[Getter],
        found: FieldType,
        above: str,
        siblings: Mapping[str, FieldType],
        every: Every,
        read: Optional[Getter],
    ) -> List[Getter]:
        """Returns the steps with that to several elements, from each of which `read` reads; None: as they are."""
        if found.element == STATUS_TYPE and read is not None:
            read = _of_others(read)
        plain: Getter = as_it_is if found.message else self._plain_list
        if every.pattern is None:
            return [*steps, lambda elements: numbered_elements(plain(elements), read)]
        pattern, read_one = every.pattern, read or as_it_is
        own = self._own_name(found)
        if own is not None:
            name_of = operator.attrgetter(own)
            return [
                *steps,
                lambda elements: named_elements(elements, list(map(name_of, elements)), above, pattern, read_one),
            ]
        beside = self._names_beside(above, siblings)
        both = operator.attrgetter(above, beside)

        def get(message: Any) -> Any:
            elements, names = both(message)
            if len(elements) != len(names):
                return unequal(above, beside, len(elements), len(names)) if len(elements) else ABSENT
            return named_elements(plain(elements), names, beside, pattern, read_one)

        return [*steps[:-1], get]

    def _plain_list(self, elements: Sequence[Any]) -> Any:
        """Returns an array as a list, unless it is too long to be read: an image has a million elements."""
        return elements if len(elements) > MOST_ELEMENTS else self._dialect.plain(elements)

    def _value(self, found: FieldType, *, is_selected: bool, is_element: bool) -> List[Getter]:
        """Returns the functions that make of a native value what a path returns. `is_selected`: it is in an array."""
        if found.message and not found.is_array:
            types = self._dialect.field_types(found.message)
            if found.element in TIME_TYPES:
                return [operator.attrgetter(*tuple(types)[:2]), lambda parts: stamp_of(*parts)]
            if found.element == STATUS_TYPE:
                level = self._reader(types["level"])
                return [lambda status: DriverStatus(level(status.level), status.message)]
            if is_selected and "key" in types and "value" in types:
                return [operator.attrgetter("value"), number_of_text]
        if is_element and (found.message or found.is_array):
            return [lambda value: NOT_A_NUMBER]
        read = self._reader(found)
        return [] if read is as_it_is else [read]


def _of_others(read: Getter) -> Getter:
    """Returns a function that reads a status as `read` does, unless it is one of this package's nodes."""

    def get(status: Any) -> Any:
        return ABSENT if is_own_status(status.name, (pair.key for pair in status.values)) else read(status)

    return get


def _chain(steps: Sequence[Getter]) -> Getter:
    if len(steps) == 1:
        return steps[0]

    def get(message: Any) -> Any:
        try:
            for step in steps:
                message = step(message)
                if message is ABSENT or type(message) is BadDatum:
                    break
        except IndexError:
            return None
        return message

    return get
