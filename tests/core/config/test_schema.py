"""The schema: what is read from a configuration, from JSON, from the texts of an address and from rows."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Optional, Tuple, get_type_hints

import pytest

from robot_health_monitor.core.config.schema import (
    REQUIRED,
    Time,
    declared,
    parameters,
    read_record,
    read_section,
    read_texts,
    row_reader,
)
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.model import Level


@dataclass(frozen=True)
class Recorder:
    """A section of a configuration."""

    name: str
    file: str = declared(REQUIRED, "path of the file", is_path=True)
    keep_days: float = declared(90.0, "age, in days", 0.01, 36_500.0)
    level: Level = declared(Level.WARN, "lowest level", choices=("WARN", "ERROR"))
    topics: Tuple[str, ...] = declared((), "names of topics", 1)
    secret: str = declared("", "an address", is_secret=True)
    port: Optional[int] = declared(None, "port", 0, 65_535)

    def mistakes(self, given: Mapping[str, Any]) -> Iterator[Tuple[str, str]]:
        if self.keep_days > 10.0 and self.port is not None:
            yield "port", "expected no port"


@dataclass(frozen=True)
class State:
    """A record."""

    count: int = declared(REQUIRED, "", 0)
    latched: Level = declared(Level.OK)
    flapping: bool = declared(False)
    text: str = declared("", "", None, 10, any_text=True)
    since: Optional[float] = declared(None)
    extra: Optional[Mapping[str, Any]] = declared(None)


def read(found: object) -> Recorder:
    return read_section(Recorder, found, ("black_box",), "/etc", name="box")


def test_a_section_has_its_values_its_defaults_and_absolute_paths() -> None:
    assert read({"file": "data/../a.db", "level": "ERROR", "port": 9090, "keep_days": 3}) == Recorder(
        "box", "/etc/a.db", 3.0, Level.ERROR, (), "", 9090
    )
    assert read({"file": "/a"}) == Recorder("box", "/a")


def test_every_mistake_of_a_section_is_reported_in_its_order_with_its_path() -> None:
    with pytest.raises(ConfigError) as raised:
        read({"keep_dys": 1, "level": "OK", "topics": ["/a", " "], "port": 70_000, "secret": ["token"]})
    assert [str(error) for error in raised.value.all] == [
        "black_box.keep_dys: unknown key; did you mean keep_days?",
        "black_box.level: expected one of WARN, ERROR, got 'OK'",
        "black_box.topics: expected a list of texts that are not empty, got ['/a', ' ']",
        "black_box.port: expected a whole number from 0 to 65535, got 70000",
        "black_box.secret: expected printable text, got something else",
        "black_box.file: is missing; expected the path of the file",
    ]


@pytest.mark.parametrize("file", [None, ""])
def test_an_empty_text_is_no_required_path(file: object) -> None:
    with pytest.raises(ConfigError, match=r"black_box\.file: "):
        read({"file": file})


def test_values_that_contradict_each_other_are_mistakes_of_the_section() -> None:
    with pytest.raises(ConfigError) as raised:
        read({"file": "/a", "port": 1})
    assert [str(error) for error in raised.value.all] == ["black_box.port: expected no port"]


def test_an_unknown_key_lists_the_known_ones_in_its_details() -> None:
    with pytest.raises(ConfigError) as raised:
        read({"file": "/a", "keep_dys": 1})
    assert raised.value.details == "the keys here: file, keep_days, level, topics, secret, port"


def test_a_secret_is_not_shown_in_a_repr() -> None:
    assert "token" not in repr(Recorder("box", "/a", secret="token"))


def test_the_keys_of_a_section_are_a_table() -> None:
    table = {each.name: each for each in parameters(Recorder)}
    assert list(table) == ["file", "keep_days", "level", "topics", "secret", "port"]
    assert (table["file"].default, table["level"].default, table["port"].kind) == (None, Level.WARN, int)


def test_a_record_ignores_further_keys_and_takes_null_as_the_default() -> None:
    found = {"count": 3, "latched": None, "flapping": True, "since": 5, "more": 2, "text": "a\n"}
    assert read_record(State, found) == State(3, Level.OK, True, "a\n", 5.0)
    assert read_record(State, {"count": 0, "latched": "STALE"}) == State(0, Level.STALE)


@pytest.mark.parametrize(
    ("found", "problem"),
    [
        ({}, "count: is missing; expected a whole number of at least 0"),
        ({"count": -1}, "count: expected a whole number of at least 0, got -1"),
        ({"count": 0, "latched": 2}, "latched: expected one of OK, WARN, ERROR, STALE, got 2"),
        ({"count": 0, "since": float("nan")}, "since: expected a number, got nan"),
        ({"count": 0, "flapping": 1}, "flapping: expected true or false, got 1"),
        ({"count": 0, "extra": []}, "extra: expected a mapping, got []"),
        ({"count": 0, "text": "x" * 11}, "text: expected a text of at most 10 characters, got 'xxxxxxxxxxx'"),
        ([], "expected a mapping, got []"),
    ],
)
def test_a_record_that_cannot_be_used_is_one_line(found: Any, problem: str) -> None:
    with pytest.raises(MessageError) as raised:
        read_record(State, found)
    assert str(raised.value) == problem


@dataclass(frozen=True)
class Query:
    robot: Optional[str] = declared(None)
    limit: int = declared(100, "", 1, 1000)
    since: Optional[Time] = declared(None)
    level: Optional[Level] = declared(None)
    open: bool = declared(False)


def test_the_texts_of_an_address_become_values() -> None:
    texts = {"robot": "", "limit": "7", "since": "2026-11-22T05:00:00Z", "level": "WARN", "open": "1", "other": "x"}
    since = datetime.datetime(2026, 11, 22, 5, tzinfo=datetime.timezone.utc)
    assert read_texts(Query, texts) == Query(None, 7, since, Level.WARN, True)
    assert read_texts(Query, {"since": "2026-11-22T05:00"}).since == since
    assert read_texts(Query, {"open": "0"}) == Query()


@pytest.mark.parametrize(
    ("texts", "problem"),
    [
        ({"limit": "0"}, "limit: expected a whole number from 1 to 1000, got 0"),
        ({"limit": "five"}, "limit: expected a whole number from 1 to 1000, got 'five'"),
        ({"limit": "9" * 5000}, "limit: expected a whole number from 1 to 1000, got '99999"),
        ({"since": "yesterday"}, "since: expected a time such as 2026-11-22T05:00:00Z, got 'yesterday'"),
        ({"level": "BAD"}, "level: expected one of OK, WARN, ERROR, STALE, got 'BAD'"),
        ({"open": "yes"}, "open: expected true or false, got 'yes'"),
    ],
)
def test_a_text_that_is_no_value_is_named(texts: Dict[str, str], problem: str) -> None:
    with pytest.raises(MessageError) as raised:
        read_texts(Query, texts)
    assert str(raised.value).startswith(problem)


class Row(NamedTuple):
    id: int
    at_s: float
    level: Level
    bound: Optional[float]
    repeat: bool
    values: Mapping[str, Any]
    text: str


read_row = row_reader(Row._fields, tuple(get_type_hints(Row).values()))


def test_a_row_has_levels_as_numbers_flags_as_numbers_and_mappings_as_json() -> None:
    row = read_row((7, 1.5, 3, None, 1, '{"a": 1}', "x\ny"))
    assert row == [7, 1.5, Level.STALE, None, True, {"a": 1}, "x\ny"]


@pytest.mark.parametrize(
    "row",
    [
        ("7", 1.5, 3, None, 1, "{}", ""),
        (7, None, 3, None, 1, "{}", ""),
        (7, 1e12, 3, None, 1, "{}", ""),
        (7, 1.5, 4, None, 1, "{}", ""),
        (7, 1.5, "OK", None, 1, "{}", ""),
        (7, 1.5, 3, "x", 1, "{}", ""),
        (7, 1.5, 3, None, 2, "{}", ""),
        (7, 1.5, 3, None, 1, "[]", ""),
        (7, 1.5, 3, None, 1, "{", ""),
        (7, 1.5, 3, None, 1, "{}", b""),
    ],
)
def test_a_row_with_an_unexpected_value_is_none(row: Tuple[Any, ...]) -> None:
    assert read_row(row) is None
