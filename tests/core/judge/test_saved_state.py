"""The reader of a saved state, which comes from a file and may be of any form."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core.judge.saved_state import LONGEST_S, Saved, UnusableStateError, age_s
from robot_health_monitor.core.values.model import Level


def test_a_missing_key_is_its_default() -> None:
    saved = Saved({})
    assert (saved.flag("a"), saved.text("a"), saved.number("a"), saved.duration_s("a")) == (False, "", None, 0.0)
    assert saved.level("a") is Level.OK
    assert not saved.section("a").has("b")


def test_values_are_read_by_their_type() -> None:
    saved = Saved({"flag": True, "text": "x", "number": 20, "level": "STALE", "inner": {"number": 1.5}})
    assert (saved.flag("flag"), saved.text("text"), saved.number("number")) == (True, "x", 20.0)
    assert saved.level("level") is Level.STALE
    assert saved.section("inner").number("number") == 1.5


@pytest.mark.parametrize("found", [None, [], "text", 3, True])
def test_only_a_mapping_is_a_state(found: Any) -> None:
    with pytest.raises(UnusableStateError, match="expected a mapping"):
        Saved(found)


@pytest.mark.parametrize("found", [float("nan"), float("inf"), 10**400, True, "1", [1.0]])
def test_only_a_finite_number_is_a_number(found: Any) -> None:
    with pytest.raises(UnusableStateError, match=r"^inner\.number: expected a finite number"):
        Saved({"inner": {"number": found}}).section("inner").number("number")


@pytest.mark.parametrize(
    ("read", "values"),
    [
        ("flag", {"flag": 1}),
        ("text", {"text": 1}),
        ("level", {"level": "FATAL"}),
        ("level", {"level": 2}),
        ("section", {"section": 1}),
    ],
)
def test_another_type_is_refused(read: str, values: Mapping[str, Any]) -> None:
    with pytest.raises(UnusableStateError, match=f"^{read}: expected"):
        getattr(Saved(values), read)(read)


def test_a_list_of_numbers_is_bounded_and_has_finite_numbers_only() -> None:
    assert Saved({"times": [1, 2.5, 3.0]}).numbers("times", 2) == [1.0, 2.5]
    assert Saved({}).numbers("times", 2) == []
    for wrong in (1, "12", {"1": 2}, [float("nan")], ["1"]):
        with pytest.raises(UnusableStateError, match=r"^times: expected a"):
            Saved({"times": wrong}).numbers("times", 2)


def test_durations_are_neither_negative_nor_endless() -> None:
    saved = Saved({"negative": -1.0, "huge": 1e308})
    assert saved.duration_s("negative") == 0.0
    assert saved.duration_s("huge") == LONGEST_S


def test_nothing_began_in_the_future() -> None:
    assert age_s(100.0, 160.0) == 60.0
    assert age_s(160.0, 100.0) == 0.0
    assert age_s(-1e308, 1e308) == LONGEST_S
    assert age_s(None, 100.0) == 0.0
