"""The text of a configuration error, and the collection of several."""

from __future__ import annotations

import ast
import builtins
import doctest
import re
from pathlib import Path

import pytest
from harness.packaging_workspace import FOLDERS, NAME

from robot_health_monitor.core.values import errors
from robot_health_monitor.core.values.errors import ConfigError, Problems

ROOT = Path(__file__).resolve().parents[3]
FOUR = ("ConfigError", "MessageError", "ServiceError", "LinkError")


def is_error(bases: list[str]) -> bool:
    found = [getattr(builtins, base, None) for base in bases]
    classes = [each for each in found if isinstance(each, type)]
    return any(issubclass(each, BaseException) and not issubclass(each, Warning) for each in classes)


def errors_of_the_project() -> dict[str, list[str]]:
    """Returns the names of all classes of errors in all modules, those that need ROS too, with their bases."""
    files = [file for folder in (*FOLDERS, NAME) for file in sorted((ROOT / folder).rglob("*.py"))]
    bases = {
        node.name: [getattr(base, "attr", "") or getattr(base, "id", "") for base in node.bases]
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    }
    found: dict[str, list[str]] = {}
    while True:
        further = {
            name: of
            for name, of in bases.items()
            if name not in found and (is_error(of) or re.search(r"(Error|Exception)\Z", name) or set(of) & set(found))
        }
        if not further:
            return found
        found.update(further)


@pytest.mark.newest_python
def test_every_error_of_the_project_is_one_of_the_four_and_documented() -> None:
    found = errors_of_the_project()
    assert set(FOUR) < set(found)
    documented = dict(re.findall(r"^`(\w+)` +`(\w+)`", errors.__doc__ or "", re.MULTILINE))
    derived = {name: next((base for base in bases if base in found), "") for name, bases in found.items()}
    assert {name: base for name, base in derived.items() if name not in FOUR} == documented
    assert {name for name, base in documented.items() if base not in (*FOUR, *documented)} == set()


@pytest.mark.parametrize("name", FOUR)
def test_each_of_the_four_has_its_meaning(name: str) -> None:
    assert re.search(rf"^`{name}` +[a-z]", errors.__doc__ or "", re.MULTILINE)


def test_an_error_is_one_line_file_line_path_problem() -> None:
    error = ConfigError("expected text, got 5", ("signals", "a", "unit"), "robot.yaml", 7)
    assert str(error) == "robot.yaml:7: signals.a.unit: expected text, got 5"
    assert str(ConfigError("is empty", file="robot.yaml")) == "robot.yaml: is empty"
    assert str(ConfigError("is empty")) == "is empty"
    assert isinstance(error, ValueError)


def test_a_key_is_shown_shortened_and_without_control_characters() -> None:
    assert str(ConfigError("unknown key", ("a\n\x1b[31m", "°C"))) == "a\\n\\x1b[31m.°C: unknown key"
    assert str(ConfigError("unknown key", ("k" * 1000,))) == "k" * 77 + "...: unknown key"


def test_collected_errors_are_raised_as_the_first_with_the_others() -> None:
    problems = Problems()
    for name in ("a", "b", "c"):
        with problems:
            raise ConfigError("is wrong", (name,))
    with pytest.raises(ConfigError) as raised:
        problems.raise_if_any()
    assert str(raised.value) == "a: is wrong"
    assert [str(error) for error in raised.value.all] == ["a: is wrong", "b: is wrong", "c: is wrong"]


def test_nested_collections_keep_every_error_once() -> None:
    outer, inner = Problems(), Problems()
    outer.add(ConfigError("first"))
    with outer:
        inner.add(ConfigError("second"))
        inner.add(ConfigError("third"))
        inner.raise_if_any()
    assert [error.problem for error in outer.errors] == ["first", "second", "third"]


def test_an_error_and_the_others_can_be_placed_below_a_key() -> None:
    first = ConfigError("is missing", ("a",), "file.yaml", 3)
    first.others = (ConfigError("is empty", ("b", "c")),)
    assert [str(each) for each in first.below(("node", "params")).all] == [
        "file.yaml:3: node.params.a: is missing",
        "node.params.b.c: is empty",
    ]


def test_without_errors_nothing_is_raised() -> None:
    Problems().raise_if_any()


def test_other_exceptions_are_not_collected() -> None:
    with pytest.raises(ZeroDivisionError), Problems():
        raise ZeroDivisionError


def test_a_collection_ends_at_its_limit() -> None:
    problems = Problems()
    for number in range(Problems.LIMIT - 1):
        problems.add(ConfigError(f"mistake {number}"))
    with pytest.raises(ConfigError) as raised:
        problems.add(ConfigError(f"mistake {Problems.LIMIT - 1}"))
    assert len(raised.value.all) == Problems.LIMIT
    assert raised.value.all[-1].problem == f"mistake {Problems.LIMIT - 1}"


def test_the_example_runs() -> None:
    assert doctest.testmod(errors).failed == 0
