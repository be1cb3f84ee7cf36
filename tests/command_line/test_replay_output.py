"""What a replay shows on a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, List

from harness.recorded import values, write_bag

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery: {type: std_msgs/Float32, unit: "%", warn_below: 20.0}
      gps: {type: std_msgs/Float32, warn_below: 1.0}
"""


def replay(folder: Path, numbers: List[float]) -> List[str]:
    """Returns the arguments that replay a recording of a battery."""
    (folder / "thresholds.yaml").write_text(THRESHOLDS, encoding="utf-8")
    recording = write_bag(folder / "test.bag", values("/battery", numbers, period_s=0.1))
    return ["replay", recording, "--thresholds", str(folder / "thresholds.yaml"), "--allow-missing"]


def test_a_terminal_shows_progress_alerts_and_the_table(tmp_path: Path, on_terminal: Callable[..., Any]) -> None:
    arguments = replay(tmp_path, [50.0] * 10_000 + [10.0] * 10_000)
    program = on_terminal(*arguments, columns=110, TZ="UTC")
    assert program.wait() == 1
    alert = "2023-11-14 22:30:00 battery WARN: 10 % is below 20 % (was OK for 16 min 40 s)"
    assert b"judging" in program.bytes
    assert f"\x1b[33m{alert}".encode() in program.bytes
    first, *rest = program.rows
    assert first == alert
    assert [" ".join(line.split()) for line in rest if line][:3] == [
        "WARN: not judged: gps (/gps is not recorded)",
        "signal samples bad OK WARN ERROR STALE unknown alerts min mean max longest gap",
        "battery 20000 0 50.0 % 50.0 % 0 % 0 % 0 % 1 10 % 30 % 50 % 0.1 s",
    ]
    assert rest[-2:] == ["gps      not recorded", "1 alert; 1 signal not judged"]
    assert b"\x1b[?25h" in program.bytes  # the cursor is visible again


def test_a_simple_terminal_gets_plain_lines(tmp_path: Path, on_terminal: Callable[..., Any]) -> None:
    program = on_terminal(*replay(tmp_path, [50.0] * 20), columns=110, TERM="dumb")
    assert program.wait() == 0
    assert b"\x1b" not in program.bytes
    assert program.rows[-1] == "no alerts; 1 signal not judged"


def test_json_on_a_terminal_is_one_line_per_object(tmp_path: Path, on_terminal: Callable[..., Any]) -> None:
    program = on_terminal(*replay(tmp_path, [50.0] * 20 + [10.0]), "--json", NO_COLOR="1")
    assert program.wait() == 1
    (line,) = [line for line in program.bytes.decode().splitlines() if '"signal"' in line]
    assert '"to_level": "WARN"' in line
    assert line.rstrip().endswith("}")


def test_alerts_go_to_the_file_of_stdout_while_the_progress_bar_is_on_the_terminal(
    tmp_path: Path, on_terminal: Callable[..., Any]
) -> None:
    alerts = tmp_path / "alerts.txt"
    program = on_terminal(*replay(tmp_path, [50.0] * 20 + [10.0]), stdout=alerts, TZ="UTC")
    assert program.wait() == 1
    assert alerts.read_text(encoding="utf-8").splitlines()[0] == (
        "2023-11-14 22:13:22 battery WARN: 10 % is below 20 % (was OK for 2 s)"
    )
    assert b"judging" in program.bytes
    assert b"battery WARN" not in program.bytes


def test_a_narrow_terminal_gets_the_table_in_parts(tmp_path: Path, on_terminal: Callable[..., Any]) -> None:
    program = on_terminal(*replay(tmp_path, [50.0] * 20 + [10.0] * 20), columns=64, TZ="UTC")
    assert program.wait() == 1
    assert program.rows[-7:] == [
        "signal        samples  bad      OK    WARN  ERROR  STALE",
        "battery            40    0  51.3 %  48.7 %    0 %    0 %",
        "gps      not recorded",
        "",
        "signal   unknown  alerts   min  mean   max  longest gap",
        "battery      0 %       1  10 %  30 %  50 %        0.1 s",
        "1 alert; 1 signal not judged",
    ]
