"""Composes and constructs YAML with a bounded amount of work: files may come from untrusted users.

PyYAML's SafeLoader executes no code, but 600 characters of aliases of aliases can expand to a billion values. The
parser of ROS 2 reads no aliases, so a file that has any could not be used everywhere: they are refused.
"""

from __future__ import annotations

from typing import Any

import yaml
from yaml.constructor import ConstructorError
from yaml.error import MarkedYAMLError

from ..values import ConfigError, Path, Problems, describe, printable

MOST_VALUES = 20_000
"""Most keys and values of a file."""
DEEPEST_LEVEL = 64
"""Deepest nesting."""
LONGEST_NUMBER = 400
"""Characters of the longest number; the time that Python takes for one grows with the square of its length."""

_PREFIX = "tag:yaml.org,2002:"
_TEXT = f"{_PREFIX}str"
_NUMBERS = (f"{_PREFIX}int", f"{_PREFIX}float")
_TOO_DEEP = f"expected at most {DEEPEST_LEVEL} levels of nesting"
_TOO_DEEP_TO_SCAN = "exceeded maximum nesting depth"
"""The problem that libyaml 0.2.6 reports at 1,000 levels, which it may reach before the first node is composed."""


def load(text: str, lines: dict[Path, int], problems: Problems) -> Any:
    """Loads the only document of a text; None for an empty one.

    `lines` receives the line of each key, counted from 1; the path of a list element ends with its number, counted from
    0. `problems` receives keys that are given twice, of which the last one counts.

    Raises ConfigError, with the line but no file, for invalid YAML and aliases, and if it is too large.
    """
    try:
        _check_size(text)
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is None:
            return None
        loader.note_lines(root, (), lines, problems)
        return loader.construct_document(root)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        problem = f"{_short(error.problem)}{_hint(text, mark)}"
        if error.problem == _TOO_DEEP_TO_SCAN:
            problem = _TOO_DEEP
        raise ConfigError(f"is not valid YAML: {problem}", line=line) from None
    except yaml.reader.ReaderError as error:
        character = error.character if isinstance(error.character, int) else ord(error.character)
        line = text.count("\n", 0, error.position) + 1
        raise ConfigError(f"is not valid YAML: character #x{character:04x} is not allowed", line=line) from None
    except yaml.YAMLError as error:
        raise ConfigError(f"is not valid YAML: {_short(str(error))}") from None


def _check_size(text: str) -> None:
    """Raises MarkedYAMLError if a text has aliases, or is too deep or too large to be composed."""
    depth = nodes = 0
    events: Any = yaml.parse(text, _Parser)
    for event in events:
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        problem = ""
        if depth > DEEPEST_LEVEL:
            problem = _TOO_DEEP
        elif nodes > MOST_VALUES:
            problem = f"expected at most {MOST_VALUES} keys and values"
        elif isinstance(event, yaml.AliasEvent):
            problem = "aliases such as *name are not supported, as in ROS 2"
        if problem:
            raise MarkedYAMLError(None, None, problem, event.start_mark)


_Parser: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader


class _Loader(_Parser):  # type: ignore[misc]  # one of two classes
    """Gives every failed value its line."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        # YAML 1.1 reads 1:30:00 as 5400, ROS 2 and YAML 1.2 as text.
        if node.tag in _NUMBERS and (len(node.value) > LONGEST_NUMBER or ":" in node.value):
            node.tag = _TEXT
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError):
            # Such as the date 2020-13-45, or a text tagged as a number.
            kind = node.tag[len(_PREFIX) :] if node.tag.startswith(_PREFIX) else node.tag
            raise ConstructorError(None, None, f"this is not a valid {kind}", node.start_mark) from None

    def note_lines(self, node: Any, path: Path, lines: dict[Path, int], problems: Problems) -> None:
        """Notes the lines of all keys and list elements below a node; a key that is given twice is a problem."""
        if node.id == "sequence":
            for number, element in enumerate(node.value):
                below = (*path, str(number))
                lines.setdefault(below, element.start_mark.line + 1)
                self.note_lines(element, below, lines, problems)
        if node.id != "mapping":
            return
        own: dict[Path, int] = {}
        for key, value in node.value:
            name = self.construct_object(key, deep=True) if key.id == "scalar" else None
            below, line = (*path, name if isinstance(name, str) else describe(name)), key.start_mark.line + 1
            if below in own:
                problems.add(ConfigError(f"is given twice, first in line {own[below]}", below, line=line))
            own.setdefault(below, line)
            lines.setdefault(below, line)
            self.note_lines(value, below, lines, problems)


def _hint(text: str, mark: Any) -> str:
    """Returns how to correct a mistake at a place, as far as that is known."""
    lines = text.splitlines()
    if mark is None or mark.line >= len(lines):
        return ""
    line = lines[mark.line]
    first = line[mark.column : mark.column + 1]
    if "\t" in (*line[: len(line) - len(line.lstrip())], first):
        return "; use spaces, not tabs"
    return f'; quote it, such as "{first}"' if first in ("%", "@", "`") else ""


def _short(problem: Any) -> str:
    """Returns a problem that PyYAML describes, which may quote the file, as one short line."""
    return printable(" ".join(str(problem).split())[:120])
