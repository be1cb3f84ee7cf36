"""YAML is loaded with a bounded amount of work, with libyaml's parser and without it.

Without the bounds some of these tests do not end.
"""

from __future__ import annotations

import importlib.util
from types import ModuleType
from typing import Any, Iterator

import pytest

from robot_health_monitor.core.config import yaml_loader
from robot_health_monitor.core.values.errors import ConfigError, Path, Problems

yaml = pytest.importorskip("yaml")


@pytest.fixture(params=["libyaml", "pure Python"])
def loader(request: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module as it is with and without libyaml."""
    if request.param == "libyaml":
        if not yaml.__with_libyaml__:
            pytest.skip("this PyYAML has no libyaml")
        yield yaml_loader
        return
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    spec = importlib.util.spec_from_file_location(yaml_loader.__name__, yaml_loader.__file__)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module


def refusal(loader: ModuleType, text: str) -> ConfigError:
    with pytest.raises(ConfigError) as raised:
        loader.load(text, {}, Problems())
    assert len(str(raised.value).splitlines()) == 1 and len(str(raised.value)) < 250
    return raised.value


ALIAS = "is not valid YAML: aliases such as *name are not supported, as in ROS 2"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: &a [1]\nb: *a\n", 2),
        ("a: &a [1]\nb: [*a, *a]\n", 2),
        ("a: &a {b: 1}\nc:\n  <<: *a\n", 3),
        ("a: &a\n  b: *a\n", 2),
        ("a: &a\n- *a\n", 2),
        ("a: &a b\n*a : c\n", 2),
    ],
)
def test_an_alias_is_refused_before_it_is_expanded(loader: ModuleType, text: str, line: int) -> None:
    error = refusal(loader, text)
    assert (error.problem, error.line) == (ALIAS, line)


@pytest.mark.parametrize("text", ["[" * 90_000, "{a: " * 40_000, "- " * 90_000, "? " * 60_000])
def test_deep_nesting_is_refused_at_its_64th_level(loader: ModuleType, text: str) -> None:
    assert refusal(loader, text).problem == "is not valid YAML: expected at most 64 levels of nesting"


@pytest.mark.newest_python
def test_too_many_values_are_refused_where_they_begin(loader: ModuleType) -> None:
    error = refusal(loader, "".join(f"k{number}: 1\n" for number in range(20_000)))
    assert (error.problem, error.line) == ("is not valid YAML: expected at most 20000 keys and values", 10_000)


@pytest.mark.parametrize("number", ["9" * 5000, "0x" + "f" * 5000, ":".join(["59"] * 3000), "1." + "0" * 5000])
def test_a_number_of_thousands_of_digits_is_text(loader: ModuleType, number: str) -> None:
    assert loader.load(f"a: {number}\n", {}, Problems()) == {"a": number}


@pytest.mark.parametrize("text", ["1:30", "1:30:00", "-1:30.5"])
def test_a_sexagesimal_number_is_a_text_as_in_ros_2(loader: ModuleType, text: str) -> None:
    assert loader.load(f"a: {text}\n", {}, Problems()) == {"a": text}


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("2020-13-45", "this is not a valid timestamp"),
        ("!!int ''", "this is not a valid int"),
        ("!!int many", "this is not a valid int"),
        ("!!float many", "this is not a valid float"),
        ("!!bool maybe", "this is not a valid bool"),
        ("!!timestamp soon", "this is not a valid timestamp"),
        (
            "!!python/object/apply:os.system [ls]",
            "could not determine a constructor for the tag 'tag:yaml.org,2002:python/object/apply:os.system'",
        ),
        ("!mine 1", "could not determine a constructor for the tag '!mine'"),
        ("{[1]: 2}", "found unhashable key"),
    ],
)
def test_a_value_that_cannot_be_constructed_is_refused_with_its_line(
    loader: ModuleType, value: str, problem: str
) -> None:
    error = refusal(loader, f"a: 1\nb: {value}\n")
    assert (error.problem, error.line) == (f"is not valid YAML: {problem}", 2)


@pytest.mark.parametrize("character", ["\0", "\x07", "\x1b", "\x9b"])
def test_a_control_character_is_refused_with_its_line(loader: ModuleType, character: str) -> None:
    error = refusal(loader, f"a: 1\n°: {character}\n")
    assert (error.problem, error.line) == (
        f"is not valid YAML: character #x{ord(character):04x} is not allowed",
        2,
    )


@pytest.mark.parametrize("text", ["!" * 90_000, "'" * 90_001, '"' * 90_001, "*" * 90_000, ":" * 90_000, "&a " * 50_000])
def test_a_syntax_error_is_one_short_line(loader: ModuleType, text: str) -> None:
    assert refusal(loader, text).problem.startswith("is not valid YAML: ")


def test_lines_are_those_of_the_keys_also_in_flow_mappings_and_lists(loader: ModuleType) -> None:
    text = "base: &base\n  unit: V\n  limits: {low: 1,\n    high: 2}\nleft:\n- unit: A\n- true: 3\n"
    lines: dict[Path, int] = {}
    loader.load(text, lines, Problems())
    assert lines["base", "limits", "high"] == 4
    assert lines["left", "1"] == 7
    assert lines["left", "0", "unit"] == 6
    assert lines["left", "1", "true"] == 7


def test_keys_given_twice_are_reported_once_each_with_both_lines(loader: ModuleType) -> None:
    problems = Problems()
    tree = loader.load("a:\n  b: 1\n  b: 2\nc: 2\nc: 3\n", {}, problems)
    assert tree == {"a": {"b": 2}, "c": 3}
    assert [(each.line, each.path, each.problem) for each in problems.errors] == [
        (3, ("a", "b"), "is given twice, first in line 2"),
        (5, ("c",), "is given twice, first in line 4"),
    ]


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("unit: %", '; quote it, such as "%"'),
        ("a: {unit: %}", '; quote it, such as "%"'),
        ("name: @home", '; quote it, such as "@"'),
        ("a:\n\tb: 1", "; use spaces, not tabs"),
        ("a:\n  b: 1\n\tc: 2", "; use spaces, not tabs"),
    ],
)
def test_common_mistakes_say_how_to_correct_them(loader: ModuleType, text: str, hint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loader.load(text, {}, Problems())
    assert str(caught.value).endswith(hint)
