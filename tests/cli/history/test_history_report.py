"""The report of a history: what it shows of a night, by hand-calculated numbers, and what it may replace."""

from __future__ import annotations

import html
import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from harness.histories import transition
from harness.past import START_S, output

from robot_health_monitor.cli.history.history_file import change_history
from robot_health_monitor.cli.history.history_report import MOST_PLOTS
from robot_health_monitor.core import Level, load_config
from robot_health_monitor.core.config.kept_settings import settings_of
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.notes import add_note
from robot_health_monitor.ops.store.samples import StoredSamples, store
from robot_health_monitor.ops.store.silences import add_silence

pytestmark = pytest.mark.usefixtures("utc")

HOSTILE = "</script><script>alert(1)</script>"
SIGNALS = {
    "battery_level": {"unit": "%", "warn_below": 20.0, "hysteresis": 2.0, "for_s": 5.0},
    "drivers": {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'},
}


@pytest.fixture
def night(tmp_path: Path) -> Path:
    """Returns a history of 1000 s: two runs, 0 to 400 s and 500 to 1000 s. r1's battery was WARN from 300 to 350 s."""
    file = tmp_path / "history.db"
    now_s = [START_S]
    config = load_config({"signals": SIGNALS})
    settings = {name: settings_of(signal) for name, signal in config.signals.items()}
    for begin, end in ((0.0, 400.0), (500.0, 1000.0)):
        now_s[0] = START_S + begin
        history = History(HistorySettings(str(file)), lambda: now_s[0])
        robot = history.of_robot("r1")
        robot.restore()
        robot.record_configuration(settings)
        robot.save({"battery_level": {"level": 1}})
        history.run(lambda connection: None)
        if begin == 0.0:
            for number, (second, before, after) in enumerate(((300.0, "OK", "WARN"), (350.0, "WARN", "OK")), 1):
                now_s[0] = START_S + second
                times = {"now_s": second, "since_s": 0.0, "text": f"battery {after} {HOSTILE}"}
                robot.record(transition(number, Level[after], from_level=Level[before], **times), {}, [])
        now_s[0] = START_S + end
        history.close()
    change_history(str(file), fill)
    return file


def fill(connection: sqlite3.Connection) -> None:
    """Adds samples every 10 s, 19 % while it was WARN, else 50 %; old ones are merged; a note and a silence."""
    store(connection, [StoredSamples("r1", "battery_level", START_S, 300.0, 40.0, 60.0, 50.0, 50.0, 300, 1, Level.OK)])
    for second in range(300, 1000, 10):
        if not 400 <= second < 500:
            level = 19.0 if second < 350 else 50.0
            row = StoredSamples(
                "r1", "battery_level", START_S + second, 10.0, level, level, level, level, 10, 0, Level.OK
            )
            store(connection, [row])
    add_note(connection, 1, f"wheel {HOSTILE}", "ana", START_S + 900.0)
    add_silence(connection, parse_matchers("robot=r1"), START_S + 310.0, for_s=20.0, author="ben", reason="charging")


def report(capsys: pytest.CaptureFixture[str], file: Path, *options: str) -> str:
    """Returns the page."""
    path = file.parent / "report.html"
    assert output(capsys, file, "--report", path, *options) == ""
    return path.read_text(encoding="utf-8")


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def cells(page: str, table: str) -> list[list[str]]:
    """Returns the cells of a table without their marks."""
    found = re.search(rf'<div class="{table} table[^"]*".*?<tbody>(.*?)</tbody>', page, re.DOTALL)
    assert found is not None
    rows = re.findall(r"<tr.*?>(.*?)</tr>", found[1])
    return [
        [html.unescape(re.sub("<.*?>", "", cell)) for cell in re.findall(r"<td.*?>(.*?)</td>", row)] for row in rows
    ]


def test_the_table_has_the_samples_and_the_summary(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # 300 + 70 rows of 10, less 10 in the gap: 900 samples, and one bad. Known 900 of 1000 s, OK 850 of them.
    # Mean: (300 * 50 + 50 * 19 + 550 * 50) / 900 = 48.28.
    page = report(capsys, night)
    assert cells(page, "signals") == [
        [
            "battery_level", "901", "1", "85.0 %", "5.0 %", "0 %", "0 %", "10.0 %", "94.4 %", "1",
            "19 %", "48.28 %", "60 %", "50 s", "50 s",
        ],
    ]  # fmt: skip
    assert "<h1>History of r1</h1>" in page
    assert '<p class="verdict">1 alert</p>' in page
    assert "2023-11-14 22:13:20 to 2023-11-14 22:30:00 (16 min 40 s), times in UTC+00:00" in page


def test_the_plot_has_bands_bounds_levels_and_gaps(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (signal,) = data_of(report(capsys, night))["signals"]
    assert signal["bounds"] == [{"level": "WARN", "side": "below", "value": 20.0, "clears": 22.0}]
    assert signal["levels"] == [
        [START_S, "OK"], [START_S + 300.0, "WARN"], [START_S + 350.0, "OK"],
        [START_S + 400.0, ""], [START_S + 500.0, "OK"],
    ]  # fmt: skip
    places = [sum(signal["steps"][: count + 1]) - 1 for count in range(len(signal["steps"]))]
    times_s = [signal["start"] + (place + 0.5) * signal["width"] - START_S for place in places]
    found = {}
    for time_s, low, high in zip(times_s, signal["low"], signal["high"]):
        part = "merged" if time_s < 300 else "low" if time_s < 350 else "before" if time_s < 400 else "after"
        least, most = found.get(part, (low, high))
        found[part] = min(low, least), max(high, most)
    assert found == {"merged": (40.0, 60.0), "low": (19.0, 19.0), "before": (50.0, 50.0), "after": (50.0, 50.0)}
    assert not [time_s for time_s in times_s if 400 < time_s < 500]
    assert max(after - before for before, after in zip(times_s, times_s[1:]) if after < 400) < 2.0  # one line
    (bad_s,) = signal["bad"]
    assert bad_s == pytest.approx(START_S + 150.0, abs=1.0)


def test_alerts_have_their_notes(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = report(capsys, night)
    assert cells(page, "alerts") == [
        [
            "2023-11-14 22:18:20", "WARN",
            f"battery WARN {HOSTILE}2023-11-14 22:28:20 note by ana: wheel {HOSTILE}",
        ],
        ["2023-11-14 22:19:10", "OK", f"battery OK {HOSTILE}"],
    ]  # fmt: skip
    assert HOSTILE not in page


def test_since_begins_later_and_counts_only_what_came_then(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = report(capsys, night, "--since", "2023-11-14T22:21:40")
    ((name, samples, bad, *shares),) = cells(page, "signals")
    assert (name, samples, bad, shares[0]) == ("battery_level", "500", "0", "100 %")
    assert "no alerts" in page


def test_two_robots_have_a_column_and_a_plot_each(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def add(connection: sqlite3.Connection) -> None:
        connection.execute("INSERT INTO watches (run_id, robot, started_s) VALUES (1, 'r*', ?)", (START_S,))
        connection.execute("INSERT INTO signal_states VALUES ('r*', 'drivers[a: \"b\"]', '{}')")
        row = StoredSamples("r*", 'drivers[a: "b"]', START_S, 10.0, 1.0, 1.0, 1.0, 1.0, 1, 0, Level.OK)
        store(connection, [row])

    change_history(str(night), add)
    page = report(capsys, night)
    assert [row[:3] for row in cells(page, "signals")] == [
        ["battery_level", "r1", "901"], ['drivers[a: "b"]', "r*", "1"],
    ]  # fmt: skip
    assert [each["name"] for each in data_of(page)["signals"]] == ["battery_level (r1)", 'drivers[a: "b"] (r*)']
    assert cells(page, "alerts")[0][2] == "r1"


def test_a_configuration_that_something_else_has_changed_is_one_line(
    night: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change_history(str(night), lambda connection: connection.execute("UPDATE configurations SET text = '{\"a\": 3}'"))
    page = report(capsys, night)
    assert "the bounds of r1 cannot be read: a: expected a mapping of keys to values, got 3" in page
    assert data_of(page)["signals"][0]["bounds"] == []


def test_plots_of_many_signals_are_bounded(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def add(connection: sqlite3.Connection) -> None:
        names = [("r1", f"s{number}") for number in range(MOST_PLOTS + 9)]
        connection.executemany("INSERT INTO signal_states VALUES (?, ?, '{}')", names)

    change_history(str(night), add)
    page = report(capsys, night)
    assert f"only the {MOST_PLOTS} worst of {MOST_PLOTS + 10} signals have a plot" in page
    assert len(cells(page, "signals")) == MOST_PLOTS + 10
    assert len(data_of(page)["signals"]) == MOST_PLOTS


def test_odd_samples_are_skipped(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def spoil(connection: sqlite3.Connection) -> None:
        connection.execute("UPDATE samples SET most = 'high' WHERE start_s = ?", (START_S + 600.0,))
        connection.execute("UPDATE samples SET least = NULL, most = NULL, mean = NULL WHERE start_s = ?", (START_S,))

    change_history(str(night), spoil)
    path = night.parent / "report.html"
    output(capsys, night, "--report", path)
    ((_, samples, *_),) = cells(path.read_text(encoding="utf-8"), "signals")
    assert samples == "891"


@pytest.mark.parametrize("name", ["history.db", "history.db-wal", "history.db.lock", "ops.yaml"])
def test_what_is_read_is_never_replaced(night: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (night.parent / "ops.yaml").write_text("history: {file: history.db}\n", encoding="utf-8")
    with closing(sqlite3.connect(str(night))) as reader:  # keeps the log
        reader.execute("SELECT count(*) FROM transitions").fetchone()
        path = night.parent / name
        before = path.read_bytes()
        problem = output(capsys, "--ops", night.parent / "ops.yaml", "--report", path, "--force", code=2)
        assert problem == f"{path}: --report: is one of the files that this command reads\n"
        assert path.read_bytes() == before


def test_another_file_is_replaced_with_force_only(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = night.parent / "page.html"
    path.write_text("mine", encoding="utf-8")
    assert "exists and is not a report" in output(capsys, night, "--report", path, code=2)
    assert path.read_text(encoding="utf-8") == "mine"
    for _ in range(2):  # the second time it is a report
        output(capsys, night, "--report", path, "--force")
        output(capsys, night, "--report", path)
    assert "<h1>History of r1</h1>" in path.read_text(encoding="utf-8")


def test_nothing_to_show_writes_nothing(night: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = night.parent / "report.html"
    for options in (("--robot", "r9"), ("--since", "2999-01-01")):
        assert "--report: there is nothing to show" in output(capsys, night, "--report", path, *options, code=2)
        assert not path.exists()
    assert "--report: not allowed with --json or --csv" in output(capsys, night, "--report", path, "--json", code=2)


def test_an_alert_that_changes_its_level_is_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, now_s = tmp_path / "history.db", [START_S]
    history = History(HistorySettings(str(file)), lambda: now_s[0])
    robot = history.of_robot("r1")
    levels = (Level.OK, Level.WARN, Level.ERROR, Level.WARN, Level.OK)
    for number, (before, after) in enumerate(zip(levels, levels[1:])):
        now_s[0] += 10.0
        robot.record(transition(number, after, from_level=before), {}, [])
    history.close()
    page = report(capsys, file)
    assert '<p class="verdict">1 alert</p>' in page
    assert len(cells(page, "alerts")) == 4
