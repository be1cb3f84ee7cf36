"""The table of one robot at any size: level, reason, bounds, and nothing twice."""

from __future__ import annotations

from typing import List, Sequence

import pytest

pytest.importorskip("rich", reason="rich, which draws the table, is not installed")

from rich.cells import cell_len

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Level, Status
from robot_health_monitor.core.signal_config import LINK, read_signal
from robot_health_monitor.output.signal_table import SignalRow, short_bounds, signal_lines

BATTERY = "WARN < 20, ERROR < 10"


def row(name: str, level: int, message: str, bounds: str = "", trend: Sequence[float] = (), **values: str) -> SignalRow:
    return SignalRow(Status(name, Level(level), message, "atlas", values), bounds, trend)


def lines(rows: Sequence[SignalRow], width: int = 80, room: int = 20) -> List[str]:
    return [line.plain for line in signal_lines(rows, width, room, printable)]


def test_a_row_has_level_value_and_bounds_and_no_value_twice() -> None:
    assert lines(
        [row("battery_level", 0, "77 %", BATTERY), row("temperature", 1, "93 degC is above 80 degC", "x")]
    ) == [
        "signal         level  value  bounds",
        "battery_level  OK     77 %   WARN < 20, ERROR < 10",
        "temperature    WARN   93 degC is above 80 degC",
    ]


def test_the_reason_ends_with_the_hint_why_there_are_no_samples() -> None:
    status = Status("battery", Level.STALE, "no sample for 6 s", "atlas", {}, "no publisher on /battery")
    shown = lines([SignalRow(status, "", ())])
    assert shown[1] == "battery  STALE  no sample for 6 s [no publisher on /battery]"


def test_statistics_and_trend_are_shown_where_there_is_room() -> None:
    trend = [1.0, float("nan"), 3.0, 5.0]
    rows = [row("battery_level", 0, "77 %", BATTERY, trend, mean="76.5", min="75", max="78")]
    assert lines(rows, 120)[1] == "battery_level  OK     77 %   WARN < 20, ERROR < 10  76.5  75   78   ▁ ▅█"
    assert lines(rows, 80)[1].endswith("ERROR < 10  ▁ ▅█")
    assert lines(rows, 40)[1] == "battery_level  OK     77 %"


def test_values_that_are_all_the_same_have_a_flat_trend() -> None:
    assert lines([row("a", 0, "1", trend=[5.0, 5.0])])[1].endswith("▄▄")


def test_a_terminal_without_utf8_has_no_trend() -> None:
    rows = [row("a", 0, "1", trend=[5.0, 5.0])]
    assert all(line.plain.isascii() for line in signal_lines(rows, 80, 20, printable, bars=False))


def test_a_link_that_is_up_takes_no_line() -> None:
    assert len(lines([row(LINK, 0, "up"), row("a", 0, "1")])) == 2
    assert lines([row(LINK, 2, "down: refused")])[1] == "link    ERROR  down: refused"


def test_only_the_word_of_the_level_is_coloured() -> None:
    (_, line) = signal_lines([row("a", 2, "5 is above 3")], 80, 20, printable)
    assert [line.plain[span.start : span.end] for span in line.spans if span.style] == ["ERROR"]


def test_signals_for_which_there_is_no_room_are_counted_and_the_worst_come_first() -> None:
    rows = [row(f"s{number}", 0, "1") for number in range(9)] + [row("bad", 2, "5"), row("low", 1, "2")]
    assert lines(rows, room=5) == [
        "signal  level  value",
        "bad     ERROR  5",
        "low     WARN   2",
        "s0      OK     1",
        "and 8 more: 8 OK",
    ]


@pytest.mark.parametrize("width", [20, 30, 60, 80, 120])
def test_a_reason_is_never_cut_and_no_line_is_too_wide(width: int) -> None:
    reason = "no sample since the start 11 s ago (limit 10 s)"
    found = lines([row("a_rather_long_name_of_a_signal", 3, reason), row("b", 0, "77 %", BATTERY)], width)
    assert max(map(cell_len, found)) <= width
    assert reason in " ".join(" ".join(found).split())


def test_bounds_are_shown_with_the_side_on_which_they_alert() -> None:
    assert short_bounds(read_signal("a", {"warn_below": 20.0, "error_below": 10.5})) == "WARN < 20, ERROR < 10.5"
    assert short_bounds(read_signal("a", {"warn_above": 80.0})) == "WARN > 80"
    assert short_bounds(read_signal("a", {"stale_after_s": 3.0})) == ""
