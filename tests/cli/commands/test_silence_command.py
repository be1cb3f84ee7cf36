"""`robot-health silence`: on the file of a stopped monitor, and beside a running one."""

from __future__ import annotations

import getpass
import json
import re
import sqlite3
import threading
import time
from datetime import datetime, timezone
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
from harness.line_process import LineProcess
from harness.silences import announce
from harness.waiting import wait_for

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.commands import silence_command
from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

Start = Callable[..., LineProcess]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of a monitor that has stopped, with an open alert of each of two robots."""
    history = History(HistorySettings(str(tmp_path / "history.db")))
    for robot in ("r3", "r4"):
        states = {"battery_level": {"announced": {"level": "WARN"}}, "temperature": {"announced": {"level": "OK"}}}
        history.of_robot(robot).save(states)
        announce(history, robot, "battery_level", Level.WARN)
    history.run(lambda connection: None, 30.0)
    history.close()
    return tmp_path / "history.db"


@pytest.fixture
def silence(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., list[str]]]:
    """Returns a function that runs a command on the file, in this process, and returns its lines."""
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()

    def run(action: str, *arguments: object, code: int = 0) -> list[str]:
        assert main(["silence", action, "--history", str(file), *map(str, arguments)]) == code
        output = capsys.readouterr()
        assert not (output.out if code else output.err)
        return (output.err if code else output.out).splitlines()

    yield run
    monkeypatch.undo()
    time.tzset()


def test_a_silence_is_added_listed_and_expired(silence: Callable[..., list[str]]) -> None:
    (added,) = silence(
        "add", "robot=r3,signal=battery*", "--for", "2h", "--reason", "fan is being replaced", "--author", "ana"
    )
    assert re.fullmatch(
        r"silence 1: robot=r3,signal=battery\*, until 20\d\d-\d\d-\d\d \d\d:\d\d UTC; 1 open alert: r3 battery_level",
        added,
    )
    head, row = silence("list")
    assert head.split() == ["id", "state", "open", "alerts", "matchers", "reason", "author"]
    assert re.sub(r"[-\d]{10} \d\d:\d\d", "DATE", row) == (
        "1   until DATE UTC  1     0       robot=r3,signal=battery*  fan is being replaced  ana"
    )
    assert silence("expire", 1) == ["silence 1 ended: robot=r3,signal=battery*"]
    (listed,) = (json.loads(line) for line in silence("list", "--json"))
    assert (listed["state"], listed["open_alerts"], listed["until_resolved"]) == ("ended", 0, False)
    (problem,) = silence("expire", 1, code=2)
    assert problem.startswith("robot-health silence: silence 1 has ended already, at 20")


def test_the_silence_of_a_cause_says_that_it_covers_its_effects(file: Path, silence: Callable[..., list[str]]) -> None:
    history = History(HistorySettings(str(file)))
    history.of_robot("r3").record_configuration({"wheel": {"depends_on": ["battery_level"]}})
    announce(history, "r4", "/scan", Level.STALE)
    history.run(lambda connection: None, 30.0)
    history.close()
    assert silence("add", "robot=*", "--for", "1h")[1:] == [
        "r3 battery_level: covers the signals that it affects, as long as it lasts",
        "r4 /scan: covers the signals that it affects, as long as it lasts",
    ]


def test_who_ends_a_silence_and_why_is_stored(silence: Callable[..., list[str]]) -> None:
    for _ in range(2):
        silence("add", "robot=r3", "--for", "2h", "--author", "ana")
    silence("expire", 1, "--reason", "fan works", "--author", "eve")
    silence("expire", 2)
    by_default, ended = (json.loads(line) for line in silence("list", "--json"))
    assert (ended["author"], ended["ended_by"], ended["ended_reason"]) == ("ana", "eve", "fan works")
    assert (by_default["ended_by"], by_default["ended_reason"]) == (getpass.getuser(), "")
    assert re.search(r"ended \S+ \S+ UTC by eve +0 ", silence("list")[2])
    (error,) = silence("expire", 3, "--reason", "two\nlines", code=2)
    assert "expected a reason of one line, at most 200 characters, got 'two\\nlines'" in error


def test_until_resolved_acknowledges_what_is_open(silence: Callable[..., list[str]]) -> None:
    assert silence("add", "signal=*", "--until-resolved") == [
        "silence 1: signal=*, until resolved; 2 open alerts: r3 battery_level, r4 battery_level"
    ]
    assert silence("add", "signal=temperature", "--until-resolved", code=2) == [
        "robot-health silence: no open alert matches signal=temperature"
    ]


def test_a_silence_that_matches_nothing_known_says_so(silence: Callable[..., list[str]]) -> None:
    first, second = silence("add", "robot=r33", "--for", "1h")
    assert first.endswith("; no open alert matches now")
    assert second == "so far, no signal in this history matches robot=r33"
    (only,) = silence("add", "signal=temp*", "--for", "1h")  # it is known, and OK
    assert only.endswith("; no open alert matches now")


def test_the_author_is_by_default_the_login_name(
    silence: Callable[..., list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOGNAME", "ana")
    silence("add", "robot=r3", "--for", "1h")
    assert json.loads(silence("list", "--json")[0])["author"] == "ana"


def test_the_history_may_be_that_of_an_ops_yaml(robot_health: Start, file: Path) -> None:
    (file.parent / "ops.yaml").write_text("history: {file: history.db}\n")
    process = robot_health("silence", "list", "--ops", file.parent / "ops.yaml")
    assert process.wait() == 0
    assert process.text == "out: no active silences"


def test_the_list_neither_waits_for_a_writer_nor_holds_one_up(
    silence: Callable[..., list[str]], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    silence("add", "robot=r3", "--for", "1h")
    monitor = sqlite3.connect(str(file), isolation_level=None, timeout=0.0)
    monitor.execute("BEGIN IMMEDIATE")
    assert len(silence("list")) == 2
    monitor.execute("ROLLBACK")

    def count(*_: object) -> int:  # called while the list is made
        monitor.execute("BEGIN IMMEDIATE")
        monitor.execute("ROLLBACK")
        return 7

    monkeypatch.setattr(silence_command, "silenced_transitions", count)
    assert json.loads(silence("list", "--json")[0])["alerts"] == 7


def test_silences_that_ended_long_ago_are_listed_with_all(silence: Callable[..., list[str]], file: Path) -> None:
    silence("add", "robot=r3", "--for", "1h")
    connection = sqlite3.connect(str(file))
    with connection:
        connection.execute("UPDATE silences SET created_s = created_s - 200000, until_s = until_s - 200000")
    connection.close()
    assert silence("list") == ["no active silences"]
    assert len(silence("list", "--all")) == 2


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (
            ["add", "robot=r3"],
            "robot-health silence add: expected --for TIME, --until-resolved or --every RULE, got neither; see "
            "robot-health silence add --help",
        ),
        (
            ["add", "r3", "--for", "1h"],
            "robot-health silence: expected matchers such as robot=r3,signal=battery*: robot or signal, = or !=, and a "
            "name with * and ?; got 'r3'",
        ),
        (
            ["add", "robot=r3", "--for", "1"],
            "robot-health silence add: argument --for: expected a duration such as 30m, 1h30m or 7d, got '1'; see "
            "robot-health silence add --help",
        ),
        (["expire", "7"], "robot-health silence: there is no silence 7"),
        (
            ["expire", "all"],
            "robot-health silence expire: argument ID: expected the id of a silence, got 'all'; see robot-health "
            "silence expire --help",
        ),
    ],
)
def test_wrong_usage_is_one_line_and_code_2(
    silence: Callable[..., list[str]], arguments: list[str], problem: str
) -> None:
    action, *others = arguments
    assert silence(action, *others, code=2) == [problem]


@pytest.mark.parametrize(
    ("contents", "problem"),
    [
        (None, ": No such file or directory"),
        (b"not a database, but long enough to be taken for one" * 20, ": cannot be used: file is not a database"),
        (b"", ": cannot be used: it is empty: no monitor has written it yet"),
    ],
)
def test_a_file_that_is_no_history_is_one_line(
    robot_health: Start, tmp_path: Path, contents: Any, problem: str
) -> None:
    file = tmp_path / "other.db"
    if contents is not None:
        file.write_bytes(contents)
    process = robot_health("silence", "add", "robot=r3", "--for", "1h", "--history", file)
    assert process.wait() == 2
    assert process.text == f"err: {file}{problem}"


def test_texts_that_would_control_a_terminal_are_refused_or_shown_without_effect(
    silence: Callable[..., list[str]], file: Path
) -> None:
    (problem,) = silence("add", "robot=r3", "--for", "1h", "--reason", "\x1b[2J", code=2)
    assert problem.endswith("expected a reason of one line, at most 200 characters, got '\\x1b[2J'")
    silence("add", "robot=r3", "--for", "1h")
    connection = sqlite3.connect(str(file))
    with connection:
        connection.execute("UPDATE silences SET reason = char(27) || '[2J'")
    connection.close()
    assert "?[2J" in silence("list")[1]


class Webhook(HTTPServer):
    """Receives notifications."""

    def __init__(self) -> None:
        self.received: list[Any] = []
        received = self.received

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                received.append((body["notification"], body["signal"], body["to_level"]))
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        super().__init__(("127.0.0.1", 0), Handler)


@pytest.fixture
def webhook() -> Iterator[Webhook]:
    server = Webhook()
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.newest_python
def test_beside_a_running_monitor_a_silence_is_in_force_within_about_a_second(
    robot_health: Start, tmp_path: Path, webhook: Webhook
) -> None:
    ops, thresholds = tmp_path / "ops.yaml", tmp_path / "thresholds.yaml"
    ops.write_text(
        "history: {file: history.db}\n"
        f"notify: {{hook: {{type: webhook, url: 'http://127.0.0.1:{webhook.server_port}/', simulated: true}}}}\n"
        "server: {port: 0}\n"
    )
    thresholds.write_text(
        "alert_system: {ros__parameters: {robot_name: r3, signals: {battery_level: {warn_below: 101.0, "
        "repeat_s: 1.0}}}}\n"
    )
    monitor = robot_health("run", "--ops", ops, "--thresholds", thresholds)
    wait_for(lambda: ("firing", "battery_level", "WARN") in webhook.received)
    added = robot_health("silence", "add", "robot=r3", "--until-resolved", "--reason", "known", "--ops", ops)
    assert added.wait() == 0, added.text
    assert added.text == "out: silence 1: robot=r3, until resolved; 1 open alert: r3 battery_level"
    line = monitor.wait_for_text(" [silenced: known (until resolved)]")
    assert " battery_level WARN: " in line  # the alert stays visible
    monitor.wait_for_text(" [silenced: ")  # a request that was under way has arrived
    known = len(webhook.received)
    monitor.wait_for_text(" [silenced: ")
    monitor.wait_for_text(" [silenced: ")
    assert len(webhook.received) == known
    expired = robot_health("silence", "expire", 1, "--ops", ops)
    assert expired.wait() == 0, expired.text
    wait_for(lambda: len(webhook.received) > known)
    monitor.signal()
    assert monitor.wait() == 0


def test_a_silence_that_recurs_is_added_listed_and_shown_in_the_history(
    silence: Callable[..., list[str]], file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (added,) = silence("add", "robot=r3", "--every", "00:00-00:00", "--reason", "charging room", "--author", "ana")
    assert added == "silence 1: robot=r3, every 00:00-00:00 (UTC); 1 open alert: r3 battery_level"
    days = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
    other = days[(datetime.now(timezone.utc).weekday() + 3) % 7]
    (added,) = silence("add", "robot=r3", "--every", f"{other} 10:00-11:00", "--timezone", "UTC", "--for", "60d")
    assert re.fullmatch(
        rf"silence 2: robot=r3, every {other} 10:00-11:00 \(UTC\), until \S+ \S+ UTC; not in force now; "
        "no open alert matches now",
        added,
    )
    first, second = (json.loads(line) for line in silence("list", "--json"))
    assert (first["every"], first["timezone"], first["in_force"], first["open_alerts"]) == (
        f"{other} 10:00-11:00", "UTC", False, 0
    )  # fmt: skip
    assert (second["every"], second["in_force"], second["open_alerts"], second["until"]) == (
        "00:00-00:00", True, 1, None
    )  # fmt: skip
    assert main(["history", str(file)]) == 0
    assert "silence 1 added by ana: robot=r3, every 00:00-00:00 (UTC) (charging room)" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--every", "mon 25:00-06:00"), "such as \"mon-fri 22:00-06:00\", got 'mon 25:00-06:00'"),
        (("--every", "mondays 20:00-06:00"), "such as \"mon-fri 22:00-06:00\", got 'mondays 20:00-06:00'"),
        (
            ("--every", "20:00-06:00", "--until-resolved"),
            "a time that comes again, or until resolved; got both",
        ),
        (("--for", "2h", "--timezone", "UTC"), "--timezone: expected --every as well"),
    ],
)
def test_a_rule_that_cannot_be_is_one_line(
    silence: Callable[..., list[str]], arguments: Sequence[str], problem: str
) -> None:
    *_, line = silence("add", "robot=r3", *arguments, code=2)
    assert problem in line
