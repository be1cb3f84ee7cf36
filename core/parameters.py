"""Parameters as tables: one table serves validation, ROS 2 parameter descriptions and `docs/reference/parameters.md`.

A node's configuration is a nested mapping, as in the file under `ros__parameters`. `read_parameters` checks one level
of it against a table and returns plain values. Every mistake is a ConfigError with the key's path.
"""

from __future__ import annotations

import datetime
import math
import reprlib
from dataclasses import dataclass, replace
from typing import Any, Dict, Iterable, Iterator, Mapping, Optional, Sequence, Tuple

from .deprecation import warn_renamed
from .errors import ConfigError, Path, Problems
from .formatting import list_text

_ALLOWED: Mapping[type, str] = {
    bool: "true or false",
    str: "printable text",
    list: "a list of numbers",
    tuple: "a list of texts",
}
_MOST_CHOICES = 12
"""Choices that a message names."""
_ELEMENT_KINDS: Mapping[type, type] = {list: float, tuple: str}


@dataclass(frozen=True)
class Parameter:
    """One parameter: its meaning and its allowed values."""

    name: str
    """Key; a dotted path below the node when it is declared to a middleware."""
    kind: type
    """bool, int, float or str; list: a list of numbers; tuple: a list of texts. Lists are read as tuples."""
    default: Any
    """Value if the key is left out; None: no value, the feature is disabled."""
    description: str
    """One line, with the unit."""
    minimum: Optional[float] = None
    maximum: Optional[float] = None
    choices: Tuple[str, ...] = ()
    """The allowed texts; empty: any."""
    former: str = ""
    """Name of the key before it was renamed, which is accepted with a warning; empty: it was not."""

    def below(self, prefix: str, **changes: Any) -> Parameter:
        """Returns this parameter of the section `prefix`, by its dotted path; `changes` are fields to replace."""
        former = f"{prefix}.{self.former}" if self.former else ""
        return replace(self, name=f"{prefix}.{self.name}", former=former, **changes)

    @property
    def allowed(self) -> str:
        """The allowed values, in words."""
        if self.choices:
            return "one of " + list_text([choice or "nothing" for choice in self.choices], _MOST_CHOICES)
        if self.kind in _ALLOWED:
            return _ALLOWED[self.kind]
        noun = "a whole number" if self.kind is int else "a number"
        if self.maximum is None:
            return noun if self.minimum is None else f"{noun} of at least {self.minimum:.15g}"
        if self.minimum is None:
            return f"{noun} of at most {self.maximum:.15g}"
        return f"{noun} from {self.minimum:.15g} to {self.maximum:.15g}"

    def read(self, found: object, path: Path = ()) -> Any:
        """Returns `found` as this parameter's kind; raises ConfigError if it is not of this kind and range, and finite.

        A whole number is accepted as a float, such as YAML's `20` for a bound.
        """
        value = self._as_tuple(found) if self.kind in _ELEMENT_KINDS else self._as_kind(found)
        if value is None:
            raise ConfigError(f"expected {self.allowed}, got {describe(found)}{self._hint(found)}", path)
        return value

    def _hint(self, found: object) -> str:
        if isinstance(found, str) and self.kind in (int, float) and len(found) < 40:
            try:
                number = float(found)
            except ValueError:
                return ""
            return f"; YAML reads this as text, write {number!r}" if math.isfinite(number) else ""
        if self.kind is str and not self.choices and isinstance(found, (bool, int, float, datetime.date)):
            return "; quote it"
        return ""

    def _as_tuple(self, found: object) -> Optional[Tuple[Any, ...]]:
        if isinstance(found, (str, bytes, Mapping)) or not isinstance(found, Iterable):
            return None
        items = tuple(map(replace(self, kind=_ELEMENT_KINDS[self.kind])._as_kind, found))
        return None if None in items else items

    def _as_kind(self, found: object) -> Any:
        if self.kind is bool:
            return found if isinstance(found, bool) else None
        if self.kind is str:
            # Control characters would break the lines that contain this text.
            fits = isinstance(found, str) and found.isprintable() and (not self.choices or found in self.choices)
            return found if fits else None
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            return None
        try:
            number = float(found)
        except OverflowError:
            return None
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if not math.isfinite(number) or not low <= number <= high:
            return None
        if self.kind is not int:
            return number
        return int(found) if number.is_integer() else None


class _BoundedRepr(reprlib.Repr):
    """A `repr` whose cost does not grow with the value: configurations may contain anything."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxother = self.maxstring = self.maxlong = 60

    def repr_str(self, x: str, level: int) -> str:
        return repr(x if len(x) <= 60 else x[:60])

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to print numbers of more than 4300 digits, and is slow before that.
        return repr(x) if x.bit_length() <= 2000 else f"a number of {x.bit_length()} bits"


_bounded_repr = _BoundedRepr().repr


def describe(found: object) -> str:
    """Describes a value for an error message, in at most 60 characters."""
    if found is None:
        return "nothing"
    if isinstance(found, bool):
        return "true" if found else "false"
    if isinstance(found, Mapping):
        return "a mapping"
    if isinstance(found, datetime.date):
        return f"the date {found}"
    text = _bounded_repr(found)
    return text if len(text) <= 60 else text[:57] + "..."


def require_mapping(found: object, path: Path = ()) -> Mapping[str, Any]:
    """Returns `found`, a mapping whose keys are all text; raises ConfigError if it is something else."""
    if not isinstance(found, Mapping):
        raise ConfigError(f"expected a mapping of keys to values, got {describe(found)}", path)
    problems = Problems()
    for key in found:
        if not isinstance(key, str):
            shown = describe(key)
            problems.add(ConfigError(f"expected text as a key, got {shown}; quote it", (*path, shown)))
    problems.raise_if_any()
    return found


def unknown_key(key: str, allowed: Sequence[str], path: Path = ()) -> ConfigError:
    """Returns the error for a key of the mapping at `path` that is not one of `allowed`."""
    import difflib  # only for mistakes: it takes memory in every node

    close = difflib.get_close_matches(key[:60], allowed, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return ConfigError(f"unknown key; {hint}expected one of {', '.join(allowed)}", (*path, key))


def read_parameters(
    found: Mapping[str, Any], parameters: Sequence[Parameter], path: Path = (), sections: Sequence[str] = ()
) -> Dict[str, Any]:
    """Reads one level of a configuration: the mapping at `path`.

    Returns a value per parameter; the default for a key that is left out. `sections` are keys of nested mappings, which
    are left to the caller. Raises ConfigError with all unknown keys and values that are not allowed.
    """
    found = with_present_names(found, parameters, path)
    known = {parameter.name: parameter for parameter in parameters}
    values = {name: parameter.default for name, parameter in known.items()}
    problems = Problems()
    for key, value in found.items():
        if key in known:
            with problems:
                values[key] = known[key].read(value, (*path, key))
        elif key not in sections:
            problems.add(unknown_key(key, [*known, *sections], path))
    problems.raise_if_any()
    return values


def with_present_names(found: Mapping[str, Any], parameters: Sequence[Parameter], path: Path = ()) -> Mapping[str, Any]:
    """Returns `found` with the present names of parameters instead of their former ones, with a warning for each.

    Raises ConfigError if both names of a parameter are given.
    """
    renamed = {parameter.former: parameter.name for parameter in parameters if parameter.former}
    renamed = {former: name for former, name in renamed.items() if former in found}
    problems = Problems()
    for former, name in renamed.items():
        if name in found:
            problems.add(ConfigError(f"renamed to {name}, which is given too; remove this key", (*path, former)))
        else:
            warn_renamed(former, name, path)
    problems.raise_if_any()
    return {renamed.get(key, key): value for key, value in found.items()} if renamed else found


def flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[Tuple[str, Any]]:
    """Yields (dotted name, value) for every leaf of a nested mapping: the form in which ROS 2 names parameters."""
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def unflatten(values: Mapping[str, Any]) -> Dict[str, Any]:
    """Nests dotted names, as the inverse of `flatten`; a name that is also the prefix of another is a ConfigError."""
    tree: Dict[str, Any] = {}
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
