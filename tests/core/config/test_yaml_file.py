"""A file is read whole or refused with file, line and reason."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Callable

import pytest

from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.values.errors import ConfigError, Problems

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str) -> Path:
        path = tmp_path / "robot.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def refusal(path: object) -> str:
    """The message, with the folder left out."""
    with pytest.raises(ConfigError) as raised:
        read_yaml(path)  # type: ignore[arg-type]
    text = str(raised.value)
    assert len(text.splitlines()) == 1
    folder = f"{path}"[: -len(Path(str(path)).name)]
    return text.replace(folder, "") if folder else text


def test_a_file_is_its_mapping_and_the_line_of_every_key(write: Write) -> None:
    read = read_yaml(write("# comment\na:\n  b: 1\n\n  c: {d: 2,\n      e: 3}\n"))
    assert read.tree == {"a": {"b": 1, "c": {"d": 2, "e": 3}}}
    assert read.lines == {
        ("a",): 2,
        ("a", "b"): 3,
        ("a", "c"): 5,
        ("a", "c", "d"): 5,
        ("a", "c", "e"): 6,
    }


def test_a_path_may_be_a_text_or_a_path(write: Write) -> None:
    path = write("a: 1\n")
    assert read_yaml(str(path)).tree == read_yaml(path).tree


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")
    assert read_yaml(path).tree == {"a": 1, "b": 2}


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.yaml") == "none.yaml: cannot be read: No such file or directory"


def test_a_folder(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    assert (
        refusal(tmp_path / "folder.yaml")
        == "folder.yaml: cannot be read: expected a file, got a directory, a device or a pipe"
    )


def test_a_name_that_can_be_no_files() -> None:
    assert "cannot be read" in refusal("a\0b")


@pytest.mark.parametrize("text", ["", "# nothing but a comment\n", "---\n"])
def test_an_empty_file(write: Write, text: str) -> None:
    assert refusal(write(text)) == "robot.yaml: expected a mapping of keys to values, got nothing"


def test_a_binary_file(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_bytes(b"a: 1\n\xff\xfe\x00")
    assert refusal(tmp_path / "robot.yaml") == "robot.yaml: is not UTF-8 text: byte 5 is 0xff"


def test_control_characters(write: Write) -> None:
    assert refusal(write("a: \x07\n")).startswith("robot.yaml:1: is not valid YAML: character #x0007 is not allowed")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: 1\nb: [1, 2\nc: 3\n", 3),
        ("a: 1\n\tb: 2\n", 2),
        ("a: 'open\n", 2),
        ("a: 1\nb: *nowhere\n", 2),
        ("a: 1\nb: !!python/object:os.system {}\n", 2),
    ],
)
def test_a_syntax_error_names_its_line(write: Write, text: str, line: int) -> None:
    assert refusal(write(text)).startswith(f"robot.yaml:{line}: is not valid YAML: ")


def test_a_key_given_twice_names_both_lines(write: Write) -> None:
    assert refusal(write("a:\n  b: 1\n  c: 2\n  b: 3\n")) == "robot.yaml:4: a.b: is given twice, first in line 2"


def test_two_documents_in_one_file(write: Write) -> None:
    assert refusal(write("a: 1\n---\nb: 2\n")).startswith("robot.yaml:2: is not valid YAML: but found another document")


@pytest.mark.parametrize(
    ("text", "found"), [("- a\n- b\n", "['a', 'b']"), ("just words\n", "'just words'"), ("5\n", "5")]
)
def test_a_file_that_holds_no_mapping(write: Write, text: str, found: str) -> None:
    assert refusal(write(text)) == f"robot.yaml: expected a mapping of keys to values, got {found}"


def test_a_file_nested_too_deeply(write: Write) -> None:
    assert (
        refusal(write("{a: " * 5000 + "}" * 5000))
        == "robot.yaml:1: is not valid YAML: expected at most 64 levels of nesting"
    )


def test_an_alias_is_refused_as_ros_2_does(write: Write) -> None:
    text = "base: &base\n  unit: V\nmotor:\n  <<: *base\n  warn_above: 3\n"
    assert (
        refusal(write(text)) == "robot.yaml:4: is not valid YAML: aliases such as *name are not supported, as in ROS 2"
    )


def test_an_anchor_that_nothing_refers_to_changes_nothing(write: Write) -> None:
    assert read_yaml(write("base: &base\n  unit: V\n")).tree == {"base": {"unit": "V"}}


@pytest.mark.parametrize(("path", "line"), [(("a", "b"), 2), (("a", "missing"), 1), (("nowhere",), None), ((), None)])
def test_an_error_is_located_at_its_key_or_at_the_nearest_above_it(write: Write, path: tuple, line: int | None) -> None:
    read = read_yaml(write("a:\n  b: 1\n"))
    error = read.locate(ConfigError("is wrong", path))
    assert (error.line, error.path, error.problem, error.file) == (line, path, "is wrong", read.file)


def test_the_errors_of_a_file_are_sorted_by_line(write: Write) -> None:
    read = read_yaml(write("a:\n  b: 1\nc: 2\n"))
    error = ConfigError("late", ("c",))
    error.others = (ConfigError("early", ("a", "b")), ConfigError("late too", ("c",)))
    assert [str(each)[len(read.file) :] for each in read.locate(error).all] == [
        ":2: a.b: early",
        ":3: c: late",
        ":3: c: late too",
    ]


def test_keys_that_are_not_text_are_refused_where_they_stand(write: Write) -> None:
    with pytest.raises(ConfigError) as raised:
        read_yaml(write("a: 1\n2: b\nyes: c\n"))
    assert [(each.line, each.problem) for each in raised.value.all] == [
        (2, "expected text as a key, got 2; quote it"),
        (3, "expected text as a key, got true; quote it"),
    ]


def test_a_caller_may_collect_keys_given_twice_and_go_on(write: Write) -> None:
    problems = Problems()
    read = read_yaml(write("a: 1\na: 2\nb:\n  c: 1\n  c: 2\n"), problems)
    assert read.tree == {"a": 2, "b": {"c": 2}}
    assert [(each.line, each.path) for each in problems.errors] == [(2, ("a",)), (5, ("b", "c"))]


def test_a_file_of_too_many_bytes_is_refused_before_it_is_parsed(write: Write) -> None:
    assert refusal(write("a: 1\n" * 2_000_000)) == "robot.yaml: is too large; expected at most 200000 bytes"


def test_a_device_is_refused_before_it_is_opened() -> None:
    assert refusal("/dev/zero") == "zero: cannot be read: expected a file, got a directory, a device or a pipe"


def test_a_named_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert refusal(tmp_path / "pipe") == "pipe: cannot be read: expected a file, got a directory, a device or a pipe"
