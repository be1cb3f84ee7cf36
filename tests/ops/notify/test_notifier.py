"""Threads, a real history and real targets: nothing delays an alert, and nothing is lost."""

from __future__ import annotations

import random
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Iterator, Sequence

import pytest
from harness.http_server import HttpServer, hanging, responding
from harness.seeds import new_seed
from harness.silences import FixedSilences
from harness.transitions import transition
from harness.waiting import wait_for

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.configuration import TARGET_TYPES, HistorySettings, TargetSettings
from robot_health_monitor.ops.notify.notifier import Notifier, make_sender
from robot_health_monitor.ops.store import history as store_history
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History, RobotHistory
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.silences import add_silence

DEADLINE_S = 30.0
ROOT = Path(__file__).resolve().parents[3]


@contextmanager
def running(
    targets: Sequence[TargetSettings], file: str = "", silences: Any = None, faults: Any = None
) -> Iterator[tuple[Notifier, RobotHistory]]:
    """A history and a notifier."""
    history = History(HistorySettings(file) if file else None, faults=faults)
    notifier = Notifier(history, targets, silences or FixedSilences())
    try:
        yield notifier, history.of_robot("r3")
    finally:
        notifier.close()
        history.close()


def wait_for_every_commit() -> None:
    """For a program that is killed after all is stored, however busy the machine is."""
    store_history.COMMIT_TIMEOUT_S = 600.0


def record(history: RobotHistory, level: str, signal: str = "battery", robot: str = "r3", text: str = "") -> None:
    text = text or f"{signal} {level}"
    event = transition(to_level=Level[level], signal=signal, robot=robot, fingerprint=f"{robot}-{signal}", text=text)
    history.record(event, {"level": level}, [])


def texts(server: HttpServer, count: int) -> list[str]:
    """Waits for a number of requests and returns their alert lines."""
    return [line(server.next().json) for _ in range(count)]


def line(notification: Any) -> str:
    """Returns the alert line of a notification, whose text begins with the robot."""
    robot, _, text = notification["text"].partition(": ")
    assert robot == notification["robot"]
    return str(text)


@pytest.mark.parametrize("in_file", [False, True])
def test_transitions_reach_the_targets_that_want_them(server: HttpServer, tmp_path: Path, in_file: bool) -> None:
    targets = (
        TargetSettings("all", "webhook", url=f"{server.url}/all"),
        TargetSettings("errors", "webhook", Level.ERROR, url=f"{server.url}/errors"),
    )
    with running(targets, str(tmp_path / "history.db") if in_file else "") as (notifier, history):
        for level in ("WARN", "ERROR", "OK"):
            record(history, level)
        received = [server.next() for _ in range(5)]
        wait_for(lambda: notifier.waiting == 0)
    by_path = {path: [line(each.json) for each in received if each.path == path] for path in ("/all", "/errors")}
    assert by_path == {
        "/all": ["battery WARN", "battery ERROR", "battery OK"],
        "/errors": ["battery ERROR", "battery OK"],
    }


def test_targets_that_hang_delay_neither_the_history_nor_the_others(server: HttpServer) -> None:
    with HttpServer() as stuck:
        stuck.behave = hanging
        faults = Faults()
        hanging_targets = [TargetSettings(f"stuck{number}", "webhook", url=stuck.url) for number in range(4)]
        targets = (*hanging_targets, TargetSettings("chat", "webhook", url=server.url))
        with running(targets, faults=faults) as (notifier, history):
            for number in range(50):
                record(history, "WARN", f"s{number}")
            assert texts(server, 50) == [f"s{number} WARN" for number in range(50)]
            assert [notifier._queue.waiting[f"stuck{number}"] for number in range(4)] == [50] * 4
            assert notifier.waiting >= 200
            stuck.closing.set()  # the server closes the connections: the threads can end


def test_a_silence_holds_alerts_back_until_it_expires(server: HttpServer) -> None:
    silences = FixedSilences({("r3", "battery")})
    with running([TargetSettings("chat", "webhook", url=server.url)], silences=silences) as (_, history):
        record(history, "WARN")
        record(history, "WARN", "cpu")
        assert texts(server, 1) == ["cpu WARN"]
        silences.alerts = ()
        assert texts(server, 1) == ["battery WARN"]


def test_the_first_target_is_sent_alerts_of_this_run_and_of_the_one_before(server: HttpServer, tmp_path: Path) -> None:
    settings = HistorySettings(str(tmp_path / "history.db"))
    with closing(History(settings)) as history:
        record(history.of_robot("r3"), "WARN")
    for name in ("chat", "other"):
        target = TargetSettings(name, "webhook", url=server.url)
        with closing(History(settings)) as history, closing(Notifier(history, [target], FixedSilences())):
            if name == "chat":
                record(history.of_robot("r3"), "WARN", "cpu")
            assert sorted(texts(server, 2)) == ["battery WARN", "cpu WARN"]


def test_stored_silences_are_respected(server: HttpServer, tmp_path: Path) -> None:
    history = History(HistorySettings(str(tmp_path / "history.db")))
    silences = Silences(history)
    notifier = Notifier(history, [TargetSettings("chat", "webhook", url=server.url)], silences)
    robot = history.of_robot("r3")
    try:
        silence = silences.add(parse_matchers("signal=batt*"), for_s=3600.0)
        record(robot, "WARN")
        record(robot, "WARN", "cpu")
        assert texts(server, 1) == ["cpu WARN"]
        silences.expire(silence.id)
        assert texts(server, 1) == ["battery WARN"]
    finally:
        notifier.close()
        history.close()


def test_a_silence_of_another_process_is_in_force_at_once(
    server: HttpServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.store.database._PERIOD_S", 3600.0)  # nothing looks by itself
    file = str(tmp_path / "history.db")
    history = History(HistorySettings(file))
    silences = Silences(history)
    notifier = Notifier(history, [TargetSettings("chat", "webhook", url=server.url)], silences)
    robot = history.of_robot("r3")
    try:
        for number in range(20):
            with closing(sqlite3.connect(file, timeout=DEADLINE_S)) as connection, connection:
                add_silence(connection, parse_matchers(f"signal=s{number}"), time.time(), for_s=3600.0)
            record(robot, "WARN", f"s{number}")
            record(robot, "WARN", f"other{number}")
            assert texts(server, 1) == [f"other{number} WARN"]
    finally:
        notifier.close()
        history.close()


def test_nothing_is_lost_or_repeated_when_the_monitor_is_killed(server: HttpServer, tmp_path: Path) -> None:
    file = str(tmp_path / "history.db")
    server.behave = hanging
    program = f"""
        import time
        from test_notifier import *
        wait_for_every_commit()
        history = History(HistorySettings({file!r}))
        notifier = Notifier(history, [TargetSettings("chat", "webhook", url={server.url!r})], FixedSilences())
        for number in range(20):
            record(history.of_robot("r3"), "WARN", f"s{{number}}")
        print("recorded", flush=True)
        time.sleep(1000)
    """
    path = f"{ROOT}:{ROOT / 'tests'}:{Path(__file__).parent}"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE, env={"PYTHONPATH": path}
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"recorded\n"
    assert line(server.next().json) == "s0 WARN"  # no response yet
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    server.behave = responding(200)
    target = TargetSettings("chat", "webhook", url=server.url)
    with running([target], file) as (notifier, history):
        assert sorted(texts(server, 20)) == sorted(f"s{number} WARN" for number in range(20))
        wait_for(lambda: notifier.waiting == 0)
    with running([target], file) as (notifier, history):
        record(history, "OK", "s7")
        assert texts(server, 1) == ["s7 OK"]
        wait_for(lambda: notifier.waiting == 0)
    assert server.all() == []


def test_a_kill_within_both_waits_loses_repeats_and_prolongs_nothing(server: HttpServer, tmp_path: Path) -> None:
    file = str(tmp_path / "history.db")
    waiting = {"type": "webhook", "url": server.url, "group_wait_s": 30.0}
    settings = [{"name": "chat", **waiting}, {"name": "late", **waiting, "after_s": 60.0}]
    program = f"""
        import time
        from test_notifier import *
        wait_for_every_commit()
        history = History(HistorySettings({file!r}), lambda: 1000.0)
        targets = [TargetSettings(**each) for each in {settings!r}]
        notifier = Notifier(history, targets, FixedSilences())
        for signal in ("battery", "fan"):
            record(history.of_robot("r3"), "WARN", signal)
        print("recorded", flush=True)
        time.sleep(1000)
    """
    path = f"{ROOT}:{ROOT / 'tests'}:{Path(__file__).parent}"
    for _ in range(2):  # the second one restarts within the waits, and adds nothing new
        command = [sys.executable, "-c", textwrap.dedent(program)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env={"PYTHONPATH": path}) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"recorded\n"
            process.kill()
    clock = [1029.0]
    history = History(HistorySettings(file), lambda: clock[0])
    notifier = Notifier(history, [TargetSettings(**each) for each in settings], FixedSilences())
    history.of_robot("r3")
    wait_for(lambda: notifier.waiting > 0)
    assert server.all() == []
    text = "r3: 2 alerts: battery WARN; fan WARN"
    for now_s in (1030.0, 1061.0, 1091.0):
        clock[0] = now_s
        if now_s != 1061.0:  # then the late target is queued, and waits for others
            assert server.next().json["text"] == text
        wait_for(lambda: notifier.waiting == (2 if clock[0] == 1061.0 else 0))
    assert server.all() == []
    notifier.close()
    history.close()


def test_whatever_the_moment_of_a_kill_what_is_in_the_history_is_sent_in_order(
    server: HttpServer, tmp_path: Path
) -> None:
    chance = random.Random(new_seed())
    file, target = str(tmp_path / "history.db"), TargetSettings("chat", "webhook", url=server.url)
    program = f"""
        import itertools, time
        from test_notifier import *
        wait_for_every_commit()
        history = History(HistorySettings({file!r}))
        notifier = Notifier(history, [TargetSettings("chat", "webhook", url={server.url!r})], FixedSilences())
        robot = history.of_robot("r3")
        for number in itertools.count(int(sys.argv[1])):
            level = ("WARN", "ERROR", "OK")[number // 3 % 3]
            record(robot, level, f"s{{number % 3}}", text=str(number))
            print(number, flush=True)
            time.sleep(0.002)
    """
    path = f"{ROOT}:{ROOT / 'tests'}:{Path(__file__).parent}"
    first = 0
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(program), str(first)],
            stdout=subprocess.PIPE,
            env={"PYTHONPATH": path},
            text=True,
        )
        assert process.stdout is not None
        printed = [process.stdout.readline() for _ in range(chance.randrange(1, 60))]
        process.send_signal(signal.SIGKILL)
        process.wait()
        first = int([*printed, *process.stdout.read().split()][-1]) + 1
        process.stdout.close()
    with running([target], file) as (notifier, history):
        record(history, "WARN", "last")
        received = [server.next().json]
        while line(received[-1]) != "last WARN":
            received.append(server.next().json)
        wait_for(lambda: notifier.waiting == 0, 300.0)  # up to 240 requests
    received += [request.json for request in server.all()]
    with closing(sqlite3.connect(file)) as connection:
        stored = connection.execute("SELECT signal, to_level, text FROM transitions ORDER BY id").fetchall()
    for name in ("s0", "s1", "s2"):
        sent = [line(each) for each in received if each["signal"] == name]
        of_signal = [(level, text) for signal, level, text in stored if signal == name]
        levels = [Level.OK, *(level for level, _ in of_signal)]
        changes = [text for (level, text), before in zip(of_signal, levels) if level != before]
        # What was being sent at a kill is sent twice, without anything of the same alert in between.
        assert [text for text, before in zip(sent, ["", *sent]) if text != before] == changes


def test_a_notification_that_waited_for_6_h_carries_the_time_of_the_event(server: HttpServer, tmp_path: Path) -> None:
    file, target = str(tmp_path / "history.db"), TargetSettings("chat", "webhook", url=server.url)
    server.behave = responding(500)
    with running([target], file) as (_, history):
        record(history, "WARN")
        server.next()
    with closing(sqlite3.connect(file)) as connection:
        assert connection.execute("UPDATE notifications SET at_s = 1700000000.5").rowcount == 1  # long ago
        connection.commit()
    server.all()
    server.behave = responding(200)
    with running([target], file):
        assert server.next().json["time"] == "2023-11-14T22:13:20.500Z"


def test_alerts_of_robots_of_an_earlier_run_end(server: HttpServer, tmp_path: Path) -> None:
    file, target = str(tmp_path / "history.db"), TargetSettings("chat", "webhook", url=server.url)
    with running([target], file) as (notifier, history):
        record(history, "WARN", robot="r3")
        record(history, "WARN", robot="r4")
        texts(server, 2)
        wait_for(lambda: notifier.waiting == 0)
    with running([target], file) as (notifier, history):
        notifier.end_unwatched({"r4", "r5"})
        ended = server.next().json
        assert ended["text"] == "r3: battery OK: no longer watched"
        assert ended["notification"] == "resolved"


def test_closing_first_sends_what_waits(server: HttpServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.notify.notifier.CLOSE_TIMEOUT_S", DEADLINE_S)
    go = threading.Event()

    def behave(handler: Any) -> None:
        go.wait(DEADLINE_S)
        responding(200)(handler)

    server.behave = behave
    with running([TargetSettings("chat", "webhook", url=server.url)]) as (_, history):
        record(history, "WARN")
        record(history, "OK")
        server.next()
        go.set()
    assert texts(server, 1) == ["battery OK"]


def test_closing_does_not_wait_for_a_target_that_fails(server: HttpServer) -> None:
    server.behave = responding(500)
    faults = Faults()
    with running([TargetSettings("chat", "webhook", url=server.url)], faults=faults) as (_, history):
        record(history, "WARN")
        wait_for(faults.current)
    assert line(server.next().json) == "battery WARN"
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("notify")]


def test_the_heartbeat_follows_the_ticks(server: HttpServer) -> None:
    target = TargetSettings("alive", "heartbeat", url=f"{server.url}/ping", every_s=1.0)
    with running([target]) as (notifier, _):
        notifier.note_tick()
        assert server.next().path == "/ping"
        assert notifier.waiting == 0


def test_a_notifier_without_targets_has_no_threads() -> None:
    with running([]) as (notifier, history):
        before = [thread.name for thread in threading.enumerate()]
        assert not [name for name in before if name.startswith("notify")]
        record(history, "WARN")
        notifier.note_tick()
        notifier.end_unwatched(())
        assert notifier.waiting == 0


def test_a_target_that_raises_anything_is_a_fault_and_stops_no_other(
    server: HttpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    from robot_health_monitor.ops.notify.command import Command

    def fail(*arguments: object) -> None:
        raise RuntimeError("s3cret")

    monkeypatch.setattr(Command, "send", fail)
    faults = Faults()
    targets = (TargetSettings("horn", "command", command=("x",)), TargetSettings("chat", "webhook", url=server.url))
    with running(targets, faults=faults) as (_, history):
        record(history, "WARN")
        assert texts(server, 1) == ["battery WARN"]
        wait_for(faults.current)
        assert faults.current()["notify horn"] == (Level.WARN, "x: internal error: RuntimeError")


@pytest.mark.parametrize("type_name", [name for name in TARGET_TYPES if name != "heartbeat"])
def test_a_sender_can_be_made_for_each_type_and_contacts_nothing(type_name: str) -> None:
    sender = make_sender(TargetSettings("target", type_name, url="http://host.invalid", command=("horn",)))
    assert sender.place and not sender.warning
    assert (sender.repeat_every_s == 30.0) == (type_name == "alertmanager")
    sender.close()
