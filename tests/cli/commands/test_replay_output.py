"""What a replay shows on a terminal, and the table at its end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Mapping

from harness.recorded import values, write_bag

from robot_health_monitor.cli.commands.replay_command import row, worst_first
from robot_health_monitor.cli.output.lines import plain_table
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.recordings.judging import SignalSummary

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery: {type: std_msgs/Float32, unit: "%", warn_below: 20.0}
      gps: {type: std_msgs/Float32, warn_below: 1.0}
"""


def replay(folder: Path, numbers: list[float]) -> list[str]:
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
    first, *rest = program.rows
    assert first == alert
    assert [" ".join(line.split()) for line in rest if line][:3] == [
        "WARN: not judged: gps (/gps is not recorded)",
        "signal samples bad OK WARN ERROR STALE unknown alerts min mean max longest gap",
        "battery 20000 0 50.0 % 50.0 % 0 % 0 % 0 % 1 10 % 30 % 50 % 0.1 s",
    ]
    assert rest[-2:] == ["gps      not recorded", "1 alert; 1 signal not judged"]
    assert b"\x1b[?25l" not in program.bytes  # the cursor stays visible


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


def test_alerts_go_to_the_file_of_stdout_while_the_progress_is_on_the_terminal(
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


def summary(
    shares: Mapping[Level, float] | None = None, recorded: bool = True, samples: int = 3, unknown: float = 0.0
) -> SignalSummary:
    """Returns the summary of a battery with the values 10, 20 and 60."""
    config = read_signal("battery", {"unit": "%"})
    found = SignalSummary("a.yaml", config, "/battery", recorded, "", alerts=2)
    if samples:
        for time_s, number in ((0.0, 10.0), (1.0, 20.0), (701.0, 60.0)):
            found.note_sample(time_s, number, True)
    found.finish(0.0, 1000.0)
    found.shares, found.unknown = shares or {}, unknown
    return found


HEADS = (
    "signal", "samples", "bad", "OK", "WARN", "ERROR", "STALE", "unknown", "alerts", "min", "mean", "max", "longest gap"
)  # fmt: skip


def cells(found: SignalSummary) -> Mapping[str, str]:
    """Returns the cells by their heads."""
    return dict(zip(HEADS, row(found, False).cells(HEADS)))


def test_a_row_has_the_figures_of_a_signal() -> None:
    shares = {Level.OK: 0.75, Level.WARN: 0.125, Level.ERROR: 0.0, Level.STALE: 0.0}
    assert cells(summary(shares, unknown=0.125)) == {
        "signal": "battery", "samples": "3", "bad": "0", "OK": "75.0 %", "WARN": "12.5 %", "ERROR": "0 %",
        "STALE": "0 %", "unknown": "12.5 %", "alerts": "2",
        "min": "10 %", "mean": "30 %", "max": "60 %", "longest gap": "11 min 40 s",
    }  # fmt: skip


def test_a_share_is_0_or_100_only_if_it_is() -> None:
    found = cells(summary({Level.OK: 0.999999, Level.WARN: 0.000001, Level.ERROR: 0.0, Level.STALE: 0.0}))
    assert [found[level] for level in ("OK", "WARN", "ERROR")] == ["99.9 %", "0.1 %", "0 %"]
    found = cells(summary({Level.OK: 1.0, Level.WARN: 0.0, Level.ERROR: 0.0, Level.STALE: 0.0}))
    assert [found[level] for level in ("OK", "WARN")] == ["100 %", "0 %"]


def test_a_signal_without_samples_has_no_figures() -> None:
    found = cells(summary(samples=0, unknown=1.0))
    assert [found[name] for name in ("samples", "OK", "unknown")] == ["0", "0 %", "100 %"]
    assert [found[name] for name in ("min", "mean", "max", "longest gap")] == [*"----"]


def test_a_signal_that_is_not_recorded_says_so() -> None:
    found = row(summary(recorded=False), False).cells(HEADS)
    assert found[:2] == ["battery", "not recorded"]
    assert set(found[2:]) == {""}


def test_with_two_configurations_a_row_names_its_own() -> None:
    assert row(summary(), True).cells(["signal", "file", "samples"]) == ["battery", "a.yaml", "3"]
    assert row(summary(), False).group == ""


def test_columns_of_a_plain_table_are_aligned() -> None:
    lines = plain_table([HEADS, ["a", *["1"] * 12], ["long\x1b_name", "not recorded", *[""] * 11]], 1)
    assert lines == [
        "signal           samples  bad  OK  WARN  ERROR  STALE  unknown  alerts  min  mean  max  longest gap",
        "a                      1    1   1     1      1      1        1       1    1     1    1            1",
        "long?_name  not recorded",
    ]


def named(name: str, **shares: float) -> SignalSummary:
    """Returns the summary of a signal with shares of its time."""
    found = summary({Level[level]: share for level, share in shares.items()})
    return replace(found, config=read_signal(name, {}), alerts=max(0, len(shares) - 1))


def test_the_worst_signal_is_first() -> None:
    found = [
        named("fine", OK=1.0),
        named("warm", OK=0.1, WARN=0.9),
        named("hot", OK=0.99, ERROR=0.01),
        named("gone", OK=0.5, STALE=0.5),
        replace(named("missing"), unknown=1.0),
        named("hotter", OK=0.9, ERROR=0.1),
        replace(named("fine", OK=1.0), file="b.yaml"),
        replace(named("warm", OK=1.0), file="b.yaml"),
    ]
    found.sort(key=lambda each: each.config.name)
    order = [(each.signal, each.group) for each in worst_first([row(each, True) for each in found])]
    assert order == [
        ("hotter", "a.yaml"), ("hot", "a.yaml"), ("gone", "a.yaml"), ("warm", "a.yaml"), ("warm", "b.yaml"),
        ("missing", "a.yaml"), ("fine", "a.yaml"), ("fine", "b.yaml"),
    ]  # fmt: skip
