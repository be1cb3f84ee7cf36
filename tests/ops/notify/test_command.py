"""Real programs receive a notification on stdin, and cannot hang, flood or survive their timeout."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

import psutil
import pytest
from harness.transitions import transition
from harness.waiting import wait_for

from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify.command import Command
from robot_health_monitor.ops.notify.sender import DeliveryError, Notification

NOTIFICATION = Notification(json.loads(json_line(transition(text="line $(id); `id`"))), False, 0.0)
DEADLINE_S = 30.0


def command(*arguments: str, timeout_s: float = DEADLINE_S) -> Command:
    return Command(TargetSettings("horn", "command", command=arguments, timeout_s=timeout_s))


def shell(script: str, timeout_s: float = DEADLINE_S) -> Command:
    return command("/bin/sh", "-c", script, timeout_s=timeout_s)


def test_a_program_receives_the_json_on_stdin(tmp_path: Path) -> None:
    code = "import sys; open(sys.argv[1], 'w').write(sys.stdin.read())"
    file = tmp_path / "a file; with $(id)"  # no shell sees it
    assert command(sys.executable, "-c", code, str(file)).send(NOTIFICATION) == "ended with code 0"
    assert file.read_text() == NOTIFICATION.as_json() + "\n"


def test_a_program_that_does_not_read_stdin_is_no_failure() -> None:
    shell("exit 0").send(NOTIFICATION)


def test_another_code_than_0_is_a_failure_and_its_words_are_on_stderr(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DeliveryError, match=r"^ended with code 7$") as caught:
        shell("echo sound; echo no sound card >&2; exit 7").send(NOTIFICATION)
    assert caught.value.may_have_arrived and not caught.value.is_refused
    assert capfd.readouterr() == ("", "no sound card\n")
    with pytest.raises(DeliveryError, match=r"^killed by signal 9$"):
        shell("kill -9 $$").send(NOTIFICATION)


def test_a_program_that_does_not_exist_is_a_failure() -> None:
    with pytest.raises(DeliveryError, match=r"^cannot be started: No such file or directory$") as caught:
        command("/nowhere/horn").send(NOTIFICATION)
    assert not caught.value.may_have_arrived


def test_a_program_that_hangs_is_killed_with_the_processes_that_it_started(tmp_path: Path) -> None:
    with pytest.raises(DeliveryError, match=r"^killed after 3 s$"):
        shell(f"sleep 1000 & echo $! > {tmp_path}/pid; exec 2>&-; sleep 1000", timeout_s=3.0).send(NOTIFICATION)
    try:
        psutil.Process(int((tmp_path / "pid").read_text())).wait(DEADLINE_S)
    except psutil.NoSuchProcess:
        pass  # it has ended already


def test_a_process_left_running_in_the_background_does_not_delay(tmp_path: Path) -> None:
    shell(f"sleep 1000 & echo $! > {tmp_path}/pid").send(NOTIFICATION)
    process = psutil.Process(int((tmp_path / "pid").read_text()))
    process.kill()


def test_no_secret_of_the_monitor_reaches_a_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOT_HEALTH_TOKEN", "s3cret")
    monkeypatch.setenv("NOTIFY_SOCKET", "/run/systemd/notify")
    monkeypatch.setenv("HORN_VOLUME", "11")
    shell('test -z "$ROBOT_HEALTH_TOKEN$NOTIFY_SOCKET" && test "$HORN_VOLUME" = 11').send(NOTIFICATION)


def test_closing_kills_a_running_program(tmp_path: Path) -> None:
    horn = shell(f"echo > {tmp_path}/runs; sleep 1000")
    errors = []

    def send() -> None:
        try:
            horn.send(NOTIFICATION)
        except DeliveryError as error:
            errors.append(str(error))

    thread = threading.Thread(target=send)
    thread.start()
    wait_for((tmp_path / "runs").exists)
    horn.close()
    thread.join(DEADLINE_S)
    assert errors == ["killed by signal 9"]
    with pytest.raises(DeliveryError, match="the monitor ends"):
        horn.send(NOTIFICATION)
