"""Composes and constructs YAML with a bounded amount of work: files may come from untrusted users.

PyYAML's SafeLoader executes no code, but 600 characters of aliases of aliases can expand to a billion values. So the
size of the expanded tree is computed on the graph of nodes, before any value is constructed.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, NamedTuple, Set, Tuple

import yaml
from yaml.composer import Composer
from yaml.constructor import ConstructorError, SafeConstructor
from yaml.error import MarkedYAMLError
from yaml.resolver import Resolver

from ..values.errors import ConfigError, Path, Problems

MOST_VALUES = 20_000
"""Most keys and values of a file, with every alias expanded."""
DEEPEST_LEVEL = 64
"""Deepest nesting, with every alias expanded."""
LONGEST_NUMBER = 400
"""Characters of the longest number; the time that Python takes for one grows with the square of its length."""

_PREFIX = "tag:yaml.org,2002:"
_MERGE, _TEXT = f"{_PREFIX}merge", f"{_PREFIX}str"
_NUMBERS = (f"{_PREFIX}int", f"{_PREFIX}float")
_TOO_DEEP_TO_SCAN = "exceeded maximum nesting depth"
"""The problem that libyaml 0.2.6 reports at 1,000 levels, which it may reach before the first node is composed."""


class Document(NamedTuple):
    """A YAML document."""

    value: Any
    """None for an empty document."""
    lines: Dict[Path, int]
    """Line of each key, counted from 1; keys below an alias have the lines of its anchor. The path of a list element
    ends with its number, counted from 0."""


def load(text: str, problems: Problems) -> Document:
    """Loads the only document of a text; `problems` receives keys that are given twice, of which the last one counts.

    Raises ConfigError, with the line but no file, for invalid YAML, and if it is too large with aliases expanded.
    """
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is None:
            return Document(None, {})
        _Sizes(problems).measure(root, ())
        lines: Dict[Path, int] = {}
        _note_lines(root, (), lines)
        return Document(loader.construct_document(root), lines)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        is_deep = error.problem == _TOO_DEEP_TO_SCAN
        problem = _excess(0, DEEPEST_LEVEL + 1) if is_deep else f"{_short(error.problem)}{_hint(text, mark)}"
        raise ConfigError(f"is not valid YAML: {problem}", line=line) from None
    except yaml.reader.ReaderError as error:
        character = error.character if isinstance(error.character, int) else ord(error.character)
        line = text.count("\n", 0, error.position) + 1
        raise ConfigError(f"is not valid YAML: character #x{character:04x} is not allowed", line=line) from None
    except yaml.YAMLError as error:
        raise ConfigError(f"is not valid YAML: {_short(str(error))}") from None


if yaml.__with_libyaml__:
    from yaml.cyaml import CParser  # type: ignore[attr-defined]  # missing in its stub

    class _Parser(Composer, CParser, SafeConstructor, Resolver):
        """libyaml's scanner and parser, with PyYAML's composer: its C composer cannot be bounded."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

else:
    _Parser = yaml.SafeLoader  # type: ignore[assignment,misc]


class _Loader(_Parser):
    """Bounds the depth and the number of nodes while composing, and gives every failed value its line."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._depth += 1
        self._nodes += 1
        problem = _excess(self._nodes, self._depth)
        if problem:
            event: Any = self.peek_event()
            raise MarkedYAMLError(None, None, problem, event.start_mark)
        node: Any = super().compose_node(parent, index)
        self._depth -= 1
        # YAML 1.1 reads 1:30:00 as 5400, ROS 2 and YAML 1.2 as text.
        if node.tag in _NUMBERS and (len(node.value) > LONGEST_NUMBER or ":" in node.value):
            node.tag = _TEXT
        return node

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError):
            # Such as the date 2020-13-45, or a text tagged as a number.
            kind = node.tag[len(_PREFIX) :] if node.tag.startswith(_PREFIX) else node.tag
            raise ConstructorError(None, None, f"this is not a valid {kind}", node.start_mark) from None


class _Sizes:
    """Measures nodes, each once, and checks their keys."""

    def __init__(self, problems: Problems) -> None:
        self._problems = problems
        self._measured: Dict[int, Tuple[int, int]] = {}
        """Size and height of each node, by id."""
        self._above: Set[int] = set()
        self._lines: Dict[Path, int] = {}

    def measure(self, node: Any, path: Path) -> Tuple[int, int]:
        """Returns the number of values in the expanded tree of a node, and its height; raises if it is too large."""
        if node.id == "scalar":
            return 1, 1
        known = self._measured.get(id(node))
        if known is not None:
            return known
        line = self._lines.get(path, node.start_mark.line + 1)
        if id(node) in self._above:
            raise ConfigError("expected a finite structure, got one that contains itself", path, line=line)
        self._above.add(id(node))
        if node.id == "mapping":
            self._check_keys(node, path)
        size, height = 1, 1
        for part, part_path in _parts(node, path):
            part_size, part_height = self.measure(part, part_path)
            size, height = size + part_size, max(height, part_height + 1)
        problem = _excess(size, height)
        if problem:
            raise ConfigError(f"{problem}, got more by aliases of aliases", path, line=line)
        self._above.discard(id(node))
        self._measured[id(node)] = size, height
        return size, height

    def _check_keys(self, node: Any, path: Path) -> None:
        lines: Dict[str, int] = {}
        for key, _ in node.value:
            if key.id != "scalar" or key.tag == _MERGE:
                continue
            line, key_path = key.start_mark.line + 1, (*path, key.value)
            if key.value in lines:
                problem = f"is given twice, first in line {lines[key.value]}"
                self._problems.add(ConfigError(problem, key_path, line=line))
            else:
                lines[key.value] = line
                self._lines[key_path] = line


def _excess(values: int, levels: int) -> str:
    """Returns the bound that a tree exceeds, in words; empty if it exceeds none."""
    if levels > DEEPEST_LEVEL:
        return f"expected at most {DEEPEST_LEVEL} levels of nesting"
    return f"expected at most {MOST_VALUES} keys and values" if values > MOST_VALUES else ""


def _parts(node: Any, path: Path) -> Iterator[Tuple[Any, Path]]:
    """Yields the nodes inside a mapping or sequence with their paths; an element has the path of its sequence."""
    if node.id == "sequence":
        for element in node.value:
            yield element, path
    else:
        for key, value in node.value:
            yield key, path
            yield value, path if key.tag == _MERGE else (*path, _key_text(key))


def _note_lines(node: Any, path: Path, lines: Dict[Path, int]) -> None:
    """Notes the lines of all keys and list elements in the expanded tree of a node, whose size is bounded."""
    if node.id == "sequence":
        for number, element in enumerate(node.value):
            below = (*path, str(number))
            lines.setdefault(below, element.start_mark.line + 1)
            _note_lines(element, below, lines)
        return
    if node.id != "mapping":
        return
    merged: List[Any] = []
    for key, value in node.value:
        if key.tag == _MERGE:
            merged.extend(value.value if value.id == "sequence" else [value])
            continue
        below = (*path, _key_text(key))
        lines.setdefault(below, key.start_mark.line + 1)
        _note_lines(value, below, lines)
    for mapping in merged:  # after the mapping's own keys, which override
        _note_lines(mapping, path, lines)


def _key_text(key: Any) -> str:
    """Returns a key as error paths show it: for a key that is not text, as `describe` does."""
    if key.id != "scalar":
        return "?"
    if key.tag == f"{_PREFIX}null":
        return "nothing"
    if key.tag == f"{_PREFIX}bool":
        return "true" if key.value.lower() in ("yes", "true", "on") else "false"
    return str(key.value)


def _hint(text: str, mark: Any) -> str:
    """Returns how to correct a mistake at a place, as far as that is known."""
    lines = text.splitlines()
    if mark is None or mark.line >= len(lines):
        return ""
    line = lines[mark.line]
    if "\t" in line[: len(line) - len(line.lstrip())] or line[mark.column : mark.column + 1] == "\t":
        return "; use spaces, not tabs"
    first = line[mark.column : mark.column + 1]
    return f'; quote it, such as "{first}"' if first and first in "%@`" else ""


def _short(problem: Any) -> str:
    """Returns a problem that PyYAML describes, which may quote the file, as one short line."""
    line = " ".join(str(problem).split())
    shown = line if line.isprintable() else ascii(line)
    return shown if len(shown) <= 120 else shown[:117] + "..."
