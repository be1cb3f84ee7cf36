"""JSON for programs: transitions on one stream, the log on the other."""

from __future__ import annotations

import json
from pathlib import Path

from harness.transitions import transition

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.output.events import Entry
from robot_health_monitor.output.json_lines import JsonLines


def test_transitions_and_the_log_go_to_different_streams(tmp_path: Path) -> None:
    with open(tmp_path / "stream", "w") as stream, open(tmp_path / "log", "w") as log:
        output = JsonLines(stream, log)
        output.start(None, None)  # type: ignore[arg-type]  # JSON has no table to show
        output.add(Entry(0.0, transition()))
        output.add(Entry(0.0, LogLine(1.0, "alert_system", Severity.WARN, "disk slow")))
        output.close()
    assert json.loads((tmp_path / "stream").read_text())["signal"] == "battery_level"
    logged = (tmp_path / "log").read_text()
    assert "disk slow" in logged and "battery_level" not in logged
