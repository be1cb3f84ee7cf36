"""Patterns of names."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.values.patterns import matches_pattern


@pytest.mark.parametrize(
    ("pattern", "name", "matches"),
    [
        ("*", "", True),
        ("?", "", False),
        ("battery*", "battery", True),
        ("*battery", "my_battery", True),
        ("a[1]", "a[1]", True),  # brackets are ordinary characters
        ("a[.]b", "a.b", False),
        ("a*bcd", "abcbcd", True),
        ("*", "motor: left", True),
        ("wheel_*", "wheel_left", True),
        ("wheel_*", "wheel_", True),
        ("wheel_*", "arm_wheel_left", False),
        ("*left", "wheel_left", True),
        ("*left", "left wheel", False),
        ("*wheel*left", "a wheel on the left", True),
        ("a*b*b", "ab", False),
        ("a*b*b", "abb", True),
        ("wheel_?", "wheel_1", True),
        ("wheel_?", "wheel_", False),
        ("wheel_?", "wheel_12", False),
        ("wheel[1]*", "wheel[1] left", True),
        ("wheel[1]*", "wheel1", False),
        ("a.b*", "axb", False),
        ("Motor*", "motor", False),
        ("a*b", "a\nb", True),
    ],
)
def test_a_pattern_matches_as_in_file_names(pattern: str, name: str, matches: bool) -> None:
    assert matches_pattern(name, pattern) is matches


@given(st.text("ab*?", max_size=8), st.text("ab", max_size=8))
def test_a_pattern_matches_what_one_without_shortcuts_matches(pattern: str, name: str) -> None:
    def plain(rest: str, text: str) -> bool:
        if not rest:
            return not text
        if rest[0] == "*":
            return plain(rest[1:], text) or (text != "" and plain(rest, text[1:]))
        return text != "" and rest[0] in ("?", text[0]) and plain(rest[1:], text[1:])

    assert matches_pattern(name, pattern) is plain(pattern, name)


def test_a_pattern_of_many_stars_is_not_slow() -> None:
    assert not matches_pattern("a" * 200, "*a" * 60 + "b")  # takes centuries with fnmatch of Python 3.8
