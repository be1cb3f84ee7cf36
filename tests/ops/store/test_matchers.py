"""Matchers and patterns. The expected values are written by hand."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.store.matchers import Matcher, matchers_text, parse_matchers


@pytest.mark.parametrize(
    ("text", "matchers"),
    [
        ("robot=r3,signal=battery*", (Matcher("robot", True, "r3"), Matcher("signal", True, "battery*"))),
        (" robot = r3 , signal != link ", (Matcher("robot", True, "r3"), Matcher("signal", False, "link"))),
        ('robot="r3, left"', (Matcher("robot", True, "r3, left"),)),
        ('robot="~r3"', (Matcher("robot", True, "~r3"),)),
        ("signal=drivers[*", (Matcher("signal", True, "drivers[*"),)),
        ("signal=drivers[motor: left=1]", (Matcher("signal", True, "drivers[motor: left=1]"),)),
        (
            'signal="drivers[a, b\\\\c \\"d\\"]",robot=r3',
            (
                Matcher("signal", True, 'drivers[a, b\\c "d"]'),
                Matcher("robot", True, "r3"),
            ),
        ),
        ("robot=r3,", (Matcher("robot", True, "r3"),)),
        ("signal!=a,signal!=b", (Matcher("signal", False, "a"), Matcher("signal", False, "b"))),
    ],
)
def test_matchers_are_read(text: str, matchers: tuple[Matcher, ...]) -> None:
    assert parse_matchers(text) == matchers
    assert parse_matchers(matchers_text(matchers)) == matchers


EXPECTED = "expected matchers such as robot=r3,signal=battery*: robot or signal, = or !=, and a name with * and ?"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", f"{EXPECTED}; got ''"),
        ("r3", f"{EXPECTED}; got 'r3'"),
        ("robot=", f"{EXPECTED}; got 'robot='"),
        ('robot="r3', f"{EXPECTED}; got 'robot=\"r3'"),
        ('robot="r3" left', f"{EXPECTED}; got 'robot=\"r3\" left'"),
        ("robot=~r.*", f"{EXPECTED}; got 'robot=~r.*'"),
        ("level=WARN", f"{EXPECTED}; got 'level=WARN'"),
        ("robot=a\nb", "expected at most 500 printable characters, got 'robot=a\\nb'"),
        ("robot=" + "a" * 500, "expected at most 500 printable characters, got 'robot=" + "a" * 53),
        (",".join(["robot=a"] * 21), "expected at most 20 matchers, got 21"),
    ],
)
def test_matchers_of_another_form_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_matchers(text)
    assert str(caught.value) == problem


PARTS = ("robot", "signal", "=", "!=", "~", ",", '"', "a", " ", "*", "[", "]", ":", "\\")


@given(st.text(max_size=40) | st.lists(st.sampled_from(PARTS), max_size=12).map("".join))
def test_any_text_is_read_or_refused_and_what_is_read_can_be_written(text: str) -> None:
    try:
        matchers = parse_matchers(text)
    except ConfigError:
        return
    assert parse_matchers(matchers_text(matchers)) == matchers


@given(st.text(st.characters(blacklist_categories=("C", "Z")), min_size=1, max_size=100).filter(str.isprintable))
def test_any_name_can_be_matched(name: str) -> None:
    matchers = (Matcher("signal", True, f"drivers[{name}]"),)
    assert parse_matchers(matchers_text(matchers)) == matchers
    assert matchers[0].matches(f"drivers[{name}]")
