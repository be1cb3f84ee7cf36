"""Parameters as tables: one description serves validation, ROS 2 descriptors and the README.

A node's configuration is a nested mapping, as in the file under `ros__parameters`. `read_parameters` checks one level
of it against a table and returns plain values; whatever is wrong raises ConfigError with the key's path.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, replace
from typing import Any, Dict, Iterable, Iterator, Mapping, Optional, Sequence, Tuple

from .errors import ConfigError, Path


@dataclass(frozen=True)
class Parameter:
    """One parameter: what it means and what it may be."""

    name: str
    """Key; a dotted path below the node where a middleware is told of it."""
    kind: type
    """bool, int, float, str, or list for a list of numbers."""
    default: Any
    """Value when it is left out; None: it has none, and the feature is off."""
    description: str
    """One line, with the unit."""
    minimum: Optional[float] = None
    """Smallest value allowed, for numbers."""
    maximum: Optional[float] = None
    """Largest value allowed, for numbers."""
    choices: Tuple[str, ...] = ()
    """The texts allowed, when they are few."""

    @property
    def allowed(self) -> str:
        """What it may be, in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.kind is bool:
            return "true or false"
        if self.kind is str:
            return "a text of printable characters"
        if self.kind is list:
            return "a list of numbers"
        noun = "a whole number" if self.kind is int else "a number"
        if self.minimum is not None and self.maximum is not None:
            return f"{noun} from {self.minimum:.15g} to {self.maximum:.15g}"
        if self.minimum is not None:
            return f"{noun}, {self.minimum:.15g} or more"
        if self.maximum is not None:
            return f"{noun}, {self.maximum:.15g} or less"
        return noun

    def read(self, found: object, path: Path = ()) -> Any:
        """Returns `found` as this parameter's kind.

        A whole number passes for a float, as YAML's `20` does for a bound.

        Raises:
            ConfigError: it is of another kind, out of range, or not a finite number.
        """
        value = self._as_list(found) if self.kind is list else self._as_kind(found)
        if value is None:
            raise ConfigError(f"found {describe(found)}, allowed is {self.allowed}{self._hint(found)}", path)
        return value

    def _hint(self, found: object) -> str:
        if self.kind not in (int, float) or not isinstance(found, str):
            return ""
        try:
            return f"; YAML takes this for a text, write {float(found)!r}"
        except ValueError:
            return ""

    def _as_list(self, found: object) -> Optional[Tuple[float, ...]]:
        if isinstance(found, (str, bytes, Mapping)) or not isinstance(found, Iterable):
            return None
        numbers = [replace(self, kind=float)._as_kind(item) for item in found]
        return None if None in numbers else tuple(numbers)

    def _as_kind(self, found: object) -> Any:
        if self.kind is bool:
            return found if isinstance(found, bool) else None
        if self.kind is str:
            # What is not printable would break the lines that it is written into.
            fits = isinstance(found, str) and found.isprintable() and (not self.choices or found in self.choices)
            return found if fits else None
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            return None
        try:
            number = float(found)
        except OverflowError:
            return None
        if not math.isfinite(number) or (self.kind is int and not number.is_integer()):
            return None
        if self.minimum is not None and number < self.minimum:
            return None
        if self.maximum is not None and number > self.maximum:
            return None
        return int(found) if self.kind is int else number


def describe(found: object) -> str:
    """Says what a value is, for an error message: its text and, where that does not show it, its kind."""
    if found is None:
        return "nothing"
    if isinstance(found, bool):
        return "true" if found else "false"
    if isinstance(found, Mapping):
        return "a mapping"
    text = repr(found)
    return text if len(text) <= 60 else text[:57] + "..."


def require_mapping(found: object, path: Path = ()) -> Mapping[str, Any]:
    """Returns `found`, a mapping whose keys are all text.

    Raises:
        ConfigError: it is something else.
    """
    if not isinstance(found, Mapping):
        raise ConfigError(f"found {describe(found)}, allowed is a mapping of keys to values", path)
    for key in found:
        if not isinstance(key, str):
            raise ConfigError(f"found the key {describe(key)}, allowed are keys that are texts (quote it)", path)
    return found


def read_parameters(
    found: Mapping[str, Any], parameters: Sequence[Parameter], path: Path = (), sections: Sequence[str] = ()
) -> Dict[str, Any]:
    """Reads one level of a configuration.

    Args:
        found: the mapping at `path`.
        parameters: what it may hold.
        path: where it is, for error messages.
        sections: keys that hold mappings of their own and are left to the caller.

    Returns:
        A value per parameter, its default where it is left out.

    Raises:
        ConfigError: an unknown key, or a value that its parameter does not allow.
    """
    known = {parameter.name: parameter for parameter in parameters}
    allowed = [*known, *sections]
    for key in found:
        if key not in allowed:
            close = difflib.get_close_matches(key, allowed, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise ConfigError(f"unknown key; {hint}allowed are {', '.join(allowed)}", (*path, key))
    return {
        name: parameter.read(found[name], (*path, name)) if name in found else parameter.default
        for name, parameter in known.items()
    }


def flatten(tree: Mapping[str, Any], prefix: str = "") -> Iterator[Tuple[str, Any]]:
    """Yields (dotted name, value) for every leaf of a nested mapping: the form in which ROS 2 names parameters."""
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flatten(value, f"{name}.")
        else:
            yield name, value


def unflatten(values: Mapping[str, Any]) -> Dict[str, Any]:
    """Nests dotted names: the inverse of `flatten`.

    Raises:
        ConfigError: a name is both a value and the beginning of another name.
    """
    tree: Dict[str, Any] = {}
    for name, value in values.items():
        *parents, leaf = name.split(".")
        branch = tree
        for parent in parents:
            branch = branch.setdefault(parent, {})
            if not isinstance(branch, dict):
                break
        if not isinstance(branch, dict) or leaf in branch:
            raise ConfigError("found a value and names below it, allowed is one of them", tuple(name.split(".")))
        branch[leaf] = value
    return tree
