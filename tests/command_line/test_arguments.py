"""The types of arguments that several commands share."""

from __future__ import annotations

import argparse
import math

import pytest

from robot_health_monitor.arguments import duration, identifier, namespace, number_or_nan, port, seconds


@pytest.mark.parametrize(("text", "number"), [("0", 0), ("9090", 9090), ("65535", 65535)])
def test_ports_are_whole_numbers_of_16_bits(text: str, number: int) -> None:
    assert port(text) == number


@pytest.mark.parametrize("text", ["", "-1", "65536", "1e3", "\u0664", "000080"])
def test_other_texts_are_no_ports(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="expected a whole number from 0 to 65535"):
        port(text)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "1e9", "soon", ""])
def test_a_number_of_seconds_is_above_0_and_finite(text: str) -> None:
    assert seconds("0.5") == 0.5
    with pytest.raises(argparse.ArgumentTypeError, match="expected a number of seconds above 0"):
        seconds(text)


def test_a_number_is_read_and_everything_else_is_nan() -> None:
    assert number_or_nan("1e3") == 1000.0
    assert math.isnan(number_or_nan("1h"))


@pytest.mark.parametrize("text", ["", "x", "-1", "1.0", "1" * 19, "\u00b2"])
def test_an_identifier_is_a_whole_number(text: str) -> None:
    assert identifier("17", "the id of a silence") == 17
    with pytest.raises(argparse.ArgumentTypeError, match="expected the id of a silence, got"):
        identifier(text, "the id of a silence")


def test_a_duration_has_units() -> None:
    assert duration("1h30m") == 5400.0
    with pytest.raises(argparse.ArgumentTypeError, match="expected a duration such as"):
        duration("90")


def test_a_namespace_has_words_and_slashes() -> None:
    assert namespace("fleet/carter") == "fleet/carter"
    with pytest.raises(argparse.ArgumentTypeError, match="expected a namespace such as carter"):
        namespace("a b")
