"""Lines that a peer causes are limited."""

from __future__ import annotations

from robot_health_monitor.core.port.log_limit import LimitedLog
from robot_health_monitor.core.port.middleware import Severity


class Log:
    def __init__(self) -> None:
        self.now_s = 1000.0
        self.lines: list[str] = []
        self.limit = LimitedLog(lambda severity, text: self.lines.append(text), lambda: self.now_s)

    def write(self, kind: str, text: str) -> None:
        self.limit.write(kind, Severity.WARN, text)


def test_one_line_of_a_kind_per_minute_with_the_number_left_out() -> None:
    log = Log()
    for second in range(121):
        log.now_s = 1000.0 + second
        log.write("invalid", f"line {second}")
    assert log.lines == ["line 0", "line 60 (59 similar lines left out)", "line 120 (59 similar lines left out)"]


def test_kinds_are_limited_separately() -> None:
    log = Log()
    for kind in ("a", "b", "a", "b"):
        log.write(kind, kind)
    assert log.lines == ["a", "b"]


def test_a_peer_that_invents_kinds_is_limited_too() -> None:
    log = Log()
    for number in range(10_000):
        log.write(str(number), "line")
    assert len(log.lines) <= 101


def test_a_number_of_lines_per_minute_passes_and_the_others_are_counted() -> None:
    log = Log()
    log.limit = LimitedLog(lambda severity, text: log.lines.append(text), lambda: log.now_s, 2)
    for number in range(5):
        log.write("invalid", f"line {number}")
    assert log.lines == ["line 0", "line 1"]
    log.now_s = 1060.0
    for number in range(5, 8):
        log.write("invalid", f"line {number}")
    assert log.lines[2:] == ["line 5 (3 similar lines left out)", "line 6"]
