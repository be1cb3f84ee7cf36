"""One declarative schema for all that comes from outside: files, parameters, requests, messages, saved states, rows.

The fields of a frozen dataclass are the keys, each written once, with type, default, description and limits:

    @dataclass(frozen=True)
    class HistorySettings:
        file: str = declared(REQUIRED, "path of the SQLite file", is_path=True)
        keep_days: float = declared(90.0, "age at which entries are deleted, in days", 0.01, 36_500.0)

==================  =====================================  ===========================  =========================
function            reads                                  keys that are not declared   null, or an empty text
==================  =====================================  ===========================  =========================
`read_section`      a mapping in a configuration           are mistakes                 is a mistake
`read_record`       the JSON of a request or a state       are ignored                  the default
`read_texts`        the parameters of an address           are ignored                  the default
`row_reader`        the rows of a query, by their types    -                            None, if it is `Optional`
==================  =====================================  ===========================  =========================

Types of fields: bool, int, float, str, `Level`, `Time`, `Tuple[float, ...]`, `Tuple[str, ...]`, `JsonObject` and
`Any`, each also as `Optional[...]`; also `Union[str, int]`, `Union[float, str]`, `Union[JsonObject, List[Any]]`.
`read_section` also reads `Optional[...]` of another dataclass, which is a mapping below its key.
A key that is a word of Python has a field with a _ behind it: `from_`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import os
from functools import lru_cache
from typing import (
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    Type,
    TypeVar,
    Union,
    get_args,
    get_type_hints,
)

from ..values import ConfigError, JsonObject, Level, MessageError, Path, Problems, describe, list_text, read_json
from .parameters import MOST_SHOWN, Convert, Parameter

T = TypeVar("T")
Time = datetime.datetime

REQUIRED: Any = dataclasses.MISSING
"""Default of a key that must be given."""

_KINDS: Mapping[Any, Any] = {
    Tuple[float, ...]: list,
    Tuple[str, ...]: tuple,
    JsonObject: dict,
    Any: object,
    Union[str, int]: (int, str),
    Union[float, str]: (float, str),
    Union[JsonObject, List[Any]]: (dict, list),
}
"""Kind of parameter per type of field; of others, the type itself."""
_LONGEST_NUMBER = 25

LATEST_S = 253_402_300_000.0
"""Latest time that is accepted in a row, in s since 1970: the end of the year 9999."""


def declared(default: Any, description: str = "", *limits: Any, **options: Any) -> Any:
    """Returns the field of a key. The further arguments are those of `Parameter` after its description."""
    is_required = default is REQUIRED
    options["is_required"] = is_required
    parameter = Parameter("", object, None if is_required else default, description, *limits, **options)
    given: Dict[str, Any] = {"default_factory": dict} if default == {} else {"default": default}
    return dataclasses.field(**given, metadata={"parameter": parameter}, repr=not parameter.is_secret)


def _keys(schema: Type[Any]) -> Sequence[Parameter]:
    """Returns the keys of a dataclass, also those of mappings, whose kinds are dataclasses too."""
    types = get_type_hints(schema)
    return [
        dataclasses.replace(
            each.metadata["parameter"],
            name=each.name.rstrip("_"),
            field=each.name,
            kind=_kind_of(types[each.name])[0],
        )
        for each in dataclasses.fields(schema)
        if "parameter" in each.metadata
    ]


keys: Callable[..., Sequence[Parameter]] = lru_cache(maxsize=None)(_keys)


def _kind_of(given: Any) -> Tuple[Any, bool]:
    """Returns the kind of parameter of a type of field, and whether it may be None."""
    further = [each for each in get_args(given) if each is not type(None)]
    is_optional = type(None) in get_args(given)
    kind: Any = Union[tuple(further)] if is_optional else given
    return _KINDS.get(kind, kind), is_optional


def parameters(schema: Type[Any]) -> Tuple[Parameter, ...]:
    """Returns the keys of a dataclass as a table, without those of mappings that are dataclasses too."""
    return tuple(each for each in keys(schema) if not dataclasses.is_dataclass(each.kind))


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


def read_parameters(
    tree: JsonObject,
    parameters: Sequence[Parameter],
    path: Path = (),
    sections: Sequence[str] = (),
    problems: Optional[Problems] = None,
) -> Dict[str, Any]:
    """Reads one level of a configuration: the mapping at `path`.

    Returns a value per parameter; the default for a key that is left out. `sections` are keys of nested mappings, which
    are left to the caller. Raises ConfigError with all unknown keys and values that are not allowed, or adds them to
    `problems`, and returns the defaults for them.
    """
    known = {parameter.name: parameter for parameter in parameters}
    values = {name: parameter.default for name, parameter in known.items()}
    collected = Problems() if problems is None else problems
    for key, value in tree.items():
        below = (*path, key)
        with collected:
            if key in known:
                kind = known[key].kind
                is_section = dataclasses.is_dataclass(kind)
                values[key] = read_section(kind, value, below) if is_section else known[key].read(value, below)
            elif key not in sections:
                raise _unknown_key(key, [*known, *sections], below)
    if problems is None:
        collected.raise_if_any()
    return values


def _unknown_key(key: str, allowed: Sequence[str], path: Path) -> ConfigError:
    """Returns the error for a key that is not one of `allowed`, which its `details` lists."""
    import difflib  # only for mistakes: it takes memory in every node

    close = difflib.get_close_matches(key[:60], allowed, n=1)
    hint = f"did you mean {close[0]}?" if close else f"expected one of {list_text(list(allowed), MOST_SHOWN)}"
    return ConfigError(f"unknown key; {hint}", path, details=f"the keys here: {', '.join(allowed)}")


def read_section(schema: Type[T], section: object, path: Path = (), folder: str = "", **given: Any) -> T:
    """Reads the mapping at `path` of a configuration.

    Paths of files become absolute; they are relative to `folder`. `given` are fields without a key. A method `mistakes`
    of the dataclass yields key and problem of values that cannot be used together; its argument is the mapping. With a
    constant `CHECKS_WHOLE`, it is called only if each value by itself can be used. Raises ConfigError with every
    mistake.
    """
    tree = require_mapping(section, path)
    problems = Problems()
    table = keys(schema)
    values = read_parameters(tree, table, path, (), problems)
    for key in table:
        if key.is_required and tree.get(key.name, "") == "":
            expected = key.allowed if key.choices else f"the {key.description}"
            problems.add(ConfigError(f"is missing; expected {expected}", (*path, key.name)))
        elif key.is_path and values[key.name]:
            values[key.name] = absolute_path(values[key.name], folder)
    if getattr(schema, "CHECKS_WHOLE", False):
        problems.raise_if_any()
    result = schema(**given, **{key.field: values[key.name] for key in table})
    wrong = {error.path for error in problems.errors}
    for name, problem in getattr(result, "mistakes", lambda given: ())(tree):
        if (*path, name) not in wrong:
            problems.add(ConfigError(problem, (*path, name) if name else path))
    problems.raise_if_any()
    return result


def absolute_path(file: str, folder: str) -> str:
    """Returns the path of a file, which is relative to `folder`, as an absolute one; `~` is the home directory."""
    return os.path.normpath(os.path.join(folder, os.path.expanduser(file)))


def read_record(schema: Type[T], record: object) -> T:
    """Reads a JSON object. Raises MessageError with one line: the key, what was expected, what was found."""
    if not isinstance(record, (dict, Mapping)):
        raise MessageError(f"expected a mapping, got {describe(record)}")
    values: Dict[str, Any] = {}
    for key in keys(schema):
        value = record.get(key.name)
        values[key.field] = key.default
        if value is not None:
            values[key.field] = converted = key.convert(value)
            if converted is None:
                raise MessageError(f"{key.name}: {key.refusal(value)}")
        elif key.is_required:
            raise MessageError(f"{key.name}: is missing; expected {key.allowed}")
    return schema(**values)


def read_texts(schema: Type[T], texts: Mapping[str, str]) -> T:
    """Reads values that are given as texts, such as `limit=5` of an address; flags are 1 and 0. Raises MessageError."""
    return read_record(schema, {each.name: _read_text(each, texts) for each in keys(schema)})


def _read_text(parameter: Parameter, texts: Mapping[str, str]) -> Any:
    text = texts.get(parameter.name) or None
    if text in ("0", "1") and parameter.kind is bool:
        return text == "1"
    if text and parameter.kind in (int, float) and text.isascii() and len(text) < _LONGEST_NUMBER:
        with contextlib.suppress(ValueError):
            return parameter.kind(text)
    return text


def _object_in(text: object) -> Optional[JsonObject]:
    try:
        value = read_json(text)
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


_LEVELS = tuple(Level)
_FROM_ROW: Mapping[type, Convert] = {
    bool: lambda value: value == 1 if value in (0, 1) and isinstance(value, int) else None,
    Level: lambda value: _LEVELS[value] if isinstance(value, int) and 0 <= value < len(_LEVELS) else None,
    dict: _object_in,
}
"""Values in columns that have another form than in JSON."""


@lru_cache(maxsize=None)
def row_reader(columns: Tuple[str, ...], types: Tuple[Any, ...]) -> Callable[[Sequence[Any]], Optional[List[Any]]]:
    """Returns a function that reads a row of a database, by its columns and their types.

    It returns None if a value is not of its type. Flags are 0 and 1, levels their numbers, mappings texts of JSON. A
    column whose name ends with `_s` is a time that a calendar has, or a duration.
    """
    converts = []
    for name, given in zip(columns, types):
        kind, is_optional = _kind_of(given)
        most = LATEST_S if name.endswith("_s") else None
        parameter = Parameter(name, kind, None, "", most and -most, most, any_text=True)
        converts.append((_FROM_ROW.get(kind) or parameter.convert, is_optional))

    def read(row: Sequence[Any]) -> Optional[List[Any]]:
        values = []
        for (convert, is_optional), stored in zip(converts, row):
            value = convert(stored)
            if value is None and not (is_optional and stored is None):
                return None
            values.append(value)
        return values

    return read
