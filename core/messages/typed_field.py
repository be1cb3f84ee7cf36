"""Binds a field path to the definition of a type: every name is looked up once, before the first message."""

from __future__ import annotations

from typing import Any, Callable, NamedTuple, Sequence

from ..values import NAME_ARRAYS, ConfigError, Every, Getter, Step, key_field, parse_field_path, selected, steps_getter
from .definitions import OTHER_NAMES, TEXTS, Definitions, Field


class BoundPath(NamedTuple):
    """A path in the messages of a type."""

    steps: Sequence[Step]
    """With the names of fields as the type has them."""
    target: Field
    """What it leads to."""
    owner: str
    """The type of the message that has the last named field."""


def bound_path(definitions: Definitions, type_name: str, path: Sequence[Step]) -> BoundPath:
    """Returns a path bound to a type; raises ValueError with the reason if the type has no such field."""
    above = owner = type_name
    target = Field(type_name, type_name, None if not path or isinstance(path[0], str) else 1)
    siblings: Sequence[Field] = ()
    steps: list[Step] = []
    for step in path:
        if isinstance(step, str):
            siblings = definitions[target.kind].fields if target.size is None and target.kind in definitions else ()
            fields = {field.name: field for field in siblings}
            step = step if step in fields else OTHER_NAMES.get(step, step)
            if step not in fields:
                there = f"has {', '.join(fields)}" if fields else "is a plain value or a list, without fields"
                raise ValueError(f"{above} {there}")
            owner, above, target = target.kind, step, fields[step]
        else:
            if target.size is None:
                raise ValueError(f"{above} is a {target.kind}, not an array")
            if isinstance(step, int):
                if step >= target.size >= 0:
                    raise ValueError(f"{above} has {target.size} elements, the last one is [{target.size - 1}]")
            elif step != Every() and not _has_names(definitions, target, siblings):
                raise ValueError(f"the elements of {above} have no name and no key")
            above, siblings, target = f"an element of {above}", (), target._replace(size=None)
        steps.append(step)
    return BoundPath(steps, target, owner)


def _has_names(definitions: Definitions, array: Field, siblings: Sequence[Field]) -> bool:
    """Returns whether the elements of an array have names of their own, or in an array beside it."""
    if array.kind in definitions and key_field(field.name for field in definitions[array.kind].fields):
        return True
    beside = (field for field in siblings if field.name in NAME_ARRAYS and field.name != array.name)
    return any(field.size is not None and field.kind in TEXTS for field in beside)


def typed_getter(topic: str, type_name: str, definitions: Definitions, field: str) -> Getter:
    """Returns a function that reads `field`, a path as in `field_path.py`, from messages of a type that are mappings.

    The function returns what `mapping_getter` of `field_path.py` does, or ABSENT if the condition behind the path does
    not hold (`where.py`). Raises ConfigError, with the resolved topic, if the type has no such field or constant.
    """

    def bound(path: str) -> BoundPath:
        try:
            return bound_path(definitions, type_name, parse_field_path(path))
        except ValueError as error:
            raise ConfigError(f"{topic}: {type_name} has no field {path[:100]}; {error}") from None

    def constant(path: str, name: str) -> Callable[[Any], float]:
        for owner in (bound(path).owner, type_name):
            number = definitions[owner].numbers.get(name)
            if number is not None:
                value: float = number
                return lambda message: value
        raise ConfigError(f"{topic}: {type_name} has no constant {name} for {path[:100]}")

    return selected(topic, type_name, field, lambda path: steps_getter(bound(path).steps), constant)
