"""Numbers and durations as people read them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from robot_health_monitor.core.values.formatting import (
    bound_text,
    count_text,
    datum_text,
    duration_text,
    list_text,
    number_text,
    printable,
    with_unit,
)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (19.5, "19.5"),
        (19.299999237060547, "19.3"),  # 19.3 as a Float32
        (20.0, "20"),
        (0.0, "0"),
        (-3.25, "-3.25"),
        (123456.7, "123457"),
        (1234567.0, "1234567"),
        (0.00012345, "0.0001234"),
        (1e300, "1e+300"),
        (math.nan, "nan"),
        (math.inf, "inf"),
    ],
)
def test_numbers_have_four_digits_and_no_exponent_where_people_would_write_none(value: float, text: str) -> None:
    assert number_text(value) == text


@pytest.mark.parametrize(
    ("value", "bound", "text"),
    [
        (19.5, 20.0, "19.5"),
        (19.99999, 20.0, "19.99999"),
        (19.999999999, 20.0, "19.999999999"),
        (80.00001, 80.0, "80.00001"),
        (20.0, 20.0, "20"),
        (math.nextafter(80.0, 81.0) if hasattr(math, "nextafter") else 80.00000000000001, 80.0, "80.000000000000014"),
    ],
)
def test_a_number_beside_its_bound_has_enough_digits_to_show_its_side(value: float, bound: float, text: str) -> None:
    assert number_text(value, bound) == text


@pytest.mark.parametrize(
    ("bound", "text"),
    [
        (20.0, "20"),
        (0.15, "0.15"),
        (-40.0, "-40"),
        (0.1234567, "0.1234567"),
        (1e15, "1000000000000000.0"),
        (1e22, "1e+22"),
    ],
)
def test_bounds_are_written_in_full(bound: float, text: str) -> None:
    assert bound_text(bound) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0 s"),
        (2.38e-05, "0 s"),
        (0.0006, "0.0006 s"),
        (-2.0, "-2 s"),
        (0.25, "0.25 s"),
        (4.0, "4 s"),
        (312.0, "312 s"),
        (312.4, "312 s"),
        (599.4, "599 s"),
        (599.5, "10 min"),
        (600.0, "10 min"),
        (725.0, "12 min 5 s"),
        (3599.0, "59 min 59 s"),
        (3600.0, "1 h"),
        (90061.0, "25 h 1 min"),
        (86400.0, "24 h"),
        (359_999.0, "99 h 59 min"),
        (360_000.0, "4 d 4 h"),
        (31_536_000.0, "365 d"),
        (1e300, "1e+300 s"),
        (math.inf, "inf s"),
        (math.nan, "nan s"),
    ],
)
def test_durations_are_in_seconds_until_that_becomes_unreadable(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_a_noun_is_plural_except_after_1() -> None:
    assert [count_text(number, "alert") for number in (0, 1, 2000)] == ["0 alerts", "1 alert", "2,000 alerts"]


def test_a_long_list_is_cut_off() -> None:
    assert [list_text(names, 2) for names in ([], ["a", "b"], ["a", "b", "c"])] == ["", "a, b", "a, b, ..."]


def test_a_unit_stands_behind_the_number_if_there_is_one() -> None:
    assert with_unit("19.5", "%") == "19.5 %"
    assert with_unit("19.5", "") == "19.5"


class Mute:
    def __repr__(self) -> str:
        raise RuntimeError("no repr")


class Wide:
    def __repr__(self) -> str:
        return "header:\n  seq: 1\r\n\tstamp: 2\x00\x1b[31m\u2028end"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (math.nan, "nan"),
        (-math.inf, "-inf"),
        ("abc", "'abc'"),
        (None, "None"),
        ("x" * 100, "'" + "x" * 36 + "..."),
        (Mute(), "a Mute"),
    ],
)
def test_any_datum_can_be_written_in_forty_characters(value: Any, text: str) -> None:
    assert datum_text(value) == text
    assert len(datum_text(value)) <= 40


def test_a_datum_is_written_on_one_line_without_control_characters() -> None:
    text: str | None = datum_text(Wide())

    assert text is not None and text.isprintable()
    assert text.startswith("header: seq: 1 stamp: 2")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("husky 1: Akku für 3 °C", "husky 1: Akku für 3 °C"),
        ("a\u00a0b", "a\u00a0b"),  # no-break space
        ("\x1b[2Jgone", "?[2Jgone"),  # C0
        ("\x9b2Jgone", "?2Jgone"),  # C1: CSI in one character
        ("a\x7fb", "a?b"),  # DEL
        ("first\nsecond\r\tthird", "first?second??third"),
        ("a\u2028b\u2029c", "a?b?c"),  # line and paragraph separator
        ("\u202eevil\u2066", "?evil?"),  # bidirectional marks
        ("zero\u200bwidth\ufeff", "zero?width?"),  # format characters
        ("half \ud800", "half ?"),  # a lone surrogate
        ("", ""),
    ],
)
def test_text_from_outside_can_neither_control_a_terminal_nor_forge_a_line(text: str, shown: str) -> None:
    assert printable(text) == shown
