from __future__ import annotations

from typing import List

from aiohttp.http_exceptions import BadStatusLine

from robot_health_monitor.rosbridge.server.client_log import ClientLog


def test_lines_per_minute_are_limited_in_total_and_the_rest_is_counted() -> None:
    now_s = 0.0
    lines: List[str] = []
    limit = ClientLog(lines.append, 3, lambda: now_s)
    for number in range(10_000):
        limit.write(f"refused client {number}")
    assert lines == ["refused client 0", "refused client 1", "refused client 2"]
    now_s = 60.0
    limit.write("later")
    assert lines[3:] == ["9997 more lines about clients were suppressed", "later"]
    now_s = 120.0
    limit.write("later still")
    assert lines[5:] == ["later still"]


def test_a_text_is_one_line() -> None:
    lines: List[str] = []
    ClientLog(lines.append).write("one\nforged line\r\n")
    assert lines == ["one forged line"]


def test_a_text_is_short_and_controls_no_terminal() -> None:
    """Errors of clients may quote what they sent."""
    lines: List[str] = []
    ClientLog(lines.append).write("\x1b[31m" + "x" * 1_000_000)
    assert lines == ["?[31m" + "x" * 495]


def test_a_library_logs_one_line_without_traceback() -> None:
    lines: List[str] = []
    logger = ClientLog(lines.append).logger()
    try:
        raise RuntimeError("secret\ndetails")
    except RuntimeError:
        logger.exception("Error handling request")
    try:
        raise BadStatusLine("\x1b[31m")
    except BadStatusLine:
        logger.exception("Error handling request")
    logger.info("not shown")
    logger.warning("first %s\nsecond", "line")
    assert lines == [
        "Error handling request: RuntimeError",
        "refused a malformed HTTP request (BadStatusLine)",
        "first line",
    ]
