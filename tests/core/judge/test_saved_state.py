"""A saved state, which is written and read by the same calls; it comes from a file, and may be of any form."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core.judge.saved_state import LONGEST_S, Downtime, SavedState, UnusableStateError
from robot_health_monitor.core.values.model import Level


def read(values: object, now_s: float = 0.0, downtime: Downtime = Downtime(0.0, 0.0)) -> SavedState:  # noqa: B008
    return SavedState(now_s, values, downtime)


def test_a_missing_key_is_its_default() -> None:
    saved = read({}, 7.0)
    assert (saved.value("a", True, False), saved.value("a", "x", ""), saved.value("a", 1.0, float)) == (False, "", None)
    assert (saved.value("a", Level.WARN, Level.OK), saved.value("a", Level.WARN, Level)) == (Level.OK, None)
    assert (saved.waited_s("a", 1.0), saved.since_s("a", 1.0)) == (0.0, 7.0)
    assert saved.times_s("a", [1.0], 2) == [] and saved.section("a").value("b", "x", "") == ""


def test_what_is_written_is_read_by_the_same_calls_at_another_time() -> None:
    """Written at 100 s, which is 1,000 s since 1970; read at 5 s, 60 s later."""

    def exchange(state: SavedState, number: float, since_s: float) -> Any:
        inner = state.section("inner")
        return (
            inner.value("number", number, float),
            inner.value("flag", True, False),
            inner.value("text", "x", ""),
            inner.value("level", Level.STALE, Level.OK),
            inner.waited_s("waited_s", 3.5),
            state.since_s("begun", since_s),
            state.times_s("times", [90.0, 95.0], 5),
        )

    values: dict[str, Any] = {}
    expected = (0.0, True, "x", Level.STALE, 3.5)
    written = exchange(SavedState(100.0, values, ahead_s=900.0), 0.0, 80.0)
    assert written == (*expected, 80.0, [90.0, 95.0])
    assert values["since"] == {"begun": 980.0}
    later = read(values, 5.0, Downtime(1000.0, 1060.0))
    assert exchange(later, 9.0, 9.0) == (*expected, -75.0, [-65.0, -60.0])
    assert later.unwatched_since_s == -55.0


@pytest.mark.parametrize("found", [None, [], "text", 3, True])
def test_only_a_mapping_is_a_state(found: Any) -> None:
    with pytest.raises(UnusableStateError, match="expected a mapping"):
        read(found)


@pytest.mark.parametrize("found", [float("nan"), float("inf"), 10**400, True, "1", [1.0]])
def test_only_a_finite_number_is_a_number(found: Any) -> None:
    with pytest.raises(UnusableStateError, match=r"^inner\.number: expected a float"):
        read({"inner": {"number": found}}).section("inner").value("number", None, float)


@pytest.mark.parametrize(
    ("name", "arguments", "found"),
    [
        ("value", (True, False), 1),
        ("value", ("x", ""), 1),
        ("value", (Level.OK, Level), "FATAL"),
        ("value", (Level.OK, Level.OK), 2),
        ("value", (Level.OK, Level.OK), {}),
        ("section", (), 1),
        *(("times_s", ([], 2), wrong) for wrong in (1, "12", {"1": 2})),
    ],
)
def test_another_type_is_refused(name: str, arguments: Any, found: object) -> None:
    with pytest.raises(UnusableStateError, match=r"^key: expected"):
        getattr(read({"key": found}), name)("key", *arguments)


def test_a_list_of_times_is_bounded_and_sorted() -> None:
    assert read({"times": [1, 3.0, 2.5]}, 0.0, Downtime(4.0, 4.0)).times_s("times", [], 2) == [-3.0, -1.0]


def test_what_is_no_time_in_a_list_is_left_out() -> None:
    times = [float("nan"), "1", None, True, 2.0]
    assert read({"times": times}, 0.0, Downtime(4.0, 4.0)).times_s("times", [], 9) == [-2.0]


def test_the_attributes_of_an_object_are_written_and_read_but_for_their_defaults() -> None:
    class Part:
        def __init__(self) -> None:
            self._level, self.is_set, self.bound = Level.WARN, True, 7.5

    values: dict[str, Any] = {}
    SavedState(0.0, values).fields(Part(), _level=Level.OK, is_set=True, bound=float)
    assert values == {"level": "WARN", "bound": 7.5}
    again = Part()
    read({"level": "STALE", "is_set": False}).fields(again, _level=Level.OK, is_set=True, bound=float)
    assert (again._level, again.is_set, again.bound) == (Level.STALE, False, None)


def test_durations_are_neither_negative_nor_endless() -> None:
    saved = read({"negative": -1.0, "huge": 1e308})
    assert saved.waited_s("negative") == 0.0
    assert saved.waited_s("huge") == LONGEST_S


@pytest.mark.parametrize(("since", "age_s"), [(100.0, 60.0), (220.0, 0.0), (-1e308, LONGEST_S)])
def test_nothing_began_in_the_future(since: float, age_s: float) -> None:
    values: Mapping[str, Any] = {"since": {"a": since}}
    assert read(values, 0.0, Downtime(160.0, 160.0)).since_s("a") == -age_s
