"""What a history has about an alert, for its unit test."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Tuple

import pytest
from harness.watched_signals import START_S, Of, watched

from robot_health_monitor.__main__ import main
from robot_health_monitor.core import Level
from robot_health_monitor.history_alert import history_alert
from robot_health_monitor.history_file import reading_history

SIGNALS = {
    "battery": {"warn_below": 20.0, "only_if": {"signal": "driving", "above": 0.5}, "stale_after_s": 4.0},
    "driving": {"stale_after_s": 4.0},
}


def test_the_values_of_a_condition_are_those_of_its_stored_samples(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot drives from 30 s on; its battery is below 20 from 20 s on."""
    timeline: List[Tuple[float, Any]] = []
    for number in range(50):
        timeline.append((float(number), Of("driving", 0.0 if number < 30 else 1.0)))
        timeline.append((number + 0.1, Of("battery", 50.0 if number < 20 else 15.0)))
        timeline.append((number + 0.5, None))
    file = watched(tmp_path / "history.db", SIGNALS, "battery", timeline)
    with reading_history(str(file)) as connection:
        alert = history_alert(connection, 1)
    assert (alert.title, alert.line) == ("alert 1 of r3", "battery WARN: 15 is below 20 (was OK for 29.9 s)")
    assert (alert.recorded.from_level, alert.recorded.to_level) == (Level.OK, Level.WARN)
    assert alert.recorded.wall_s == START_S + 30.0
    # Periods of 10 s end at 10, 20 and 30 s; the alert's own ends later, and its last value stands for that then.
    assert alert.others == {
        "driving": [(START_S + 10.0, 0.0), (START_S + 20.0, 0.0), (START_S + 30.0, 0.0), (START_S + 30.0, 1.0)]
    }
    assert sorted(alert.settings) == ["battery", "driving"]
    assert main(["test", "--from-alert", "1", "--history", str(file)]) == 0
    captured = capsys.readouterr()
    assert captured.err == "the test of alert 1 of r3 passes\n"
    assert '      "driving": ' in captured.out
    path = tmp_path / "alert.test.yaml"
    path.write_text(captured.out, encoding="utf-8")
    assert main(["test", str(path)]) == 0


def test_the_alerts_before_it_are_the_latest_five_of_its_signal(tmp_path: Path) -> None:
    timeline = [(float(number), 15.0 if number % 4 < 2 else 50.0) for number in range(40)]
    file = watched(tmp_path / "history.db", {"battery": {"warn_below": 20.0}}, "battery", timeline)
    with reading_history(str(file)) as connection:
        alert = history_alert(connection, 12)
    # WARN at 0, 4, 8, ... s and OK at 2, 6, ... s: the twelfth is OK at 22 s.
    assert (alert.recorded.to_level, alert.recorded.wall_s - START_S) == (Level.OK, 22.0)
    assert [(each.to_level, each.wall_s - START_S) for each in alert.recorded.before] == [
        (Level.OK, 10.0), (Level.WARN, 12.0), (Level.OK, 14.0), (Level.WARN, 16.0), (Level.OK, 18.0),
        (Level.WARN, 20.0),
    ][-5:]  # fmt: skip
