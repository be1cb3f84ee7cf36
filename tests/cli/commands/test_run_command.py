"""`robot-health run` in pipes: plain lines, JSON, exit codes, interrupts, readers that leave."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import re
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, Callable

import aiohttp
import pytest
from harness.line_process import LineProcess
from harness.unread import fill
from harness.waiting import wait_for_ticks

from robot_health_monitor.core import Transition

Start = Callable[..., LineProcess]
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
ENDING_SIGNALS = [signal.SIGINT, signal.SIGTERM]


def test_without_arguments_it_watches_the_three_signals_of_the_installed_configuration(robot_health: Start) -> None:
    process = robot_health("run")
    process.wait_for_text("[INFO] alert_system: watching battery_level on /battery_level: WARN below 20 %")
    process.wait_for_text("watching temperature on /temperature: WARN above 80 °C")
    process.wait_for_text("watching cpu_usage on /cpu_usage")
    process.wait_for_text('[INFO] battery_sensor: sensor "robot" started at 1 Hz')


def test_in_a_pipe_every_alert_is_one_plain_line_with_the_local_time(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless)
    for level, reason in [
        ("WARN", "below 80 %"),
        ("ERROR", "below 30 %"),
        ("WARN", "below 80 %"),
        ("OK", "below 80 %"),
    ]:
        line = process.wait_for_text(f" battery_level {level}: ")
        assert re.match(rf"\d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d battery_level {level}: [\d.]+ % is .*{reason} \(was ", line)
    process.signal()
    assert process.wait() == 0
    assert not process.errors
    assert not [line for line in process.lines if "alert_system: battery_level" in line.text]  # not as a log line too


def test_json_gives_one_object_per_transition_and_nothing_else_on_stdout(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless, "--json")
    transitions = [json.loads(process.wait_for_line(lambda line: line.startswith("{"))) for _ in range(4)]
    assert set(transitions[0]) == {field.name for field in dataclasses.fields(Transition)} - {"status"}
    assert [(each["from_level"], each["to_level"]) for each in transitions] == [
        ("OK", "WARN"),
        ("WARN", "ERROR"),
        ("ERROR", "WARN"),
        ("WARN", "OK"),
    ]
    first = transitions[0]
    assert (first["signal"], first["robot"], first["bound"], first["statistic"]) == (
        "battery_level",
        "atlas",
        80.0,
        "last",
    )
    assert first["value"] < 80.0
    assert first["text"].startswith("battery_level WARN: ")
    assert first["statistics"]["max"] == 100.0
    assert first["repeat"] is False
    assert transitions[1]["since_s"] == first["now_s"]
    process.signal()
    assert process.wait() == 0
    assert all(line.text.startswith("{") for line in process.lines if line.stream == "out")
    assert any("watching battery_level" in line for line in process.errors)


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_an_interrupt_ends_it_with_code_0_and_without_a_word(robot_health: Start, calm: Path, number: int) -> None:
    process = robot_health("run", "--thresholds", calm)
    process.wait_for_text("started at 20 Hz")
    process.signal(number)
    assert process.wait() == 0
    assert not process.errors


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_an_interrupt_while_it_starts_ends_it_with_code_0_too(
    robot_health_process: Start, tmp_path: Path, number: int
) -> None:
    fifo = tmp_path / "token"
    os.mkfifo(fifo)
    process = robot_health_process("run", "--token-file", fifo)
    with open(fifo, "w"):  # returns when the program has opened its end: it now waits for its token
        process.signal(number)
        assert process.wait() == 0
    assert not process.lines


@pytest.mark.newest_python
def test_a_storm_of_interrupts_while_it_starts_ends_it_as_cleanly_as_one(
    robot_health_process: Start, tmp_path: Path
) -> None:
    fifo = tmp_path / "token"
    os.mkfifo(fifo)
    process = robot_health_process("run", "--token-file", fifo)
    with open(fifo, "w"):
        while process.is_running:
            process.signal(signal.SIGTERM)
    assert process.wait() == 0
    assert not process.lines


def test_a_storm_of_interrupts_ends_it_as_cleanly_as_one(robot_health: Start, calm: Path) -> None:
    process = robot_health("run", "--thresholds", calm)
    process.wait_for_text("started at 20 Hz")
    while process.is_running:
        for number in ENDING_SIGNALS:
            process.signal(number)
    assert process.wait() == 0
    assert not process.errors


@pytest.mark.newest_python
def test_a_pause_of_the_process_is_one_warning_and_no_alert(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text(
        "alert_system: {ros__parameters: {signals: {battery_level: {warn_below: 20.0, stale_after_s: 3.0}}}}\n"
        "battery_sensor: {ros__parameters: {battery_level: {discharge_rate: 0.0}}}\n"
    )
    program = robot_health("run", "--thresholds", file, "--port", 0)
    port = int(program.wait_for_text("serving on").rpartition(":")[2])
    wait_for_ticks(port, 1.0)
    program.signal(signal.SIGSTOP)
    time.sleep(5.0)  # longer than stale_after_s: the stop is what is tested
    program.signal(signal.SIGCONT)
    program.wait_for_text("[WARN] alert_system: the monitor was stopped for ")
    wait_for_ticks(port, 2.0)
    program.signal()
    assert program.wait() == 0
    assert "battery_level STALE" not in program.text
    assert program.text.count("the monitor was stopped") == 1


@pytest.mark.newest_python
def test_a_duration_without_alerts_ends_with_code_0(robot_health: Start, calm: Path) -> None:
    process = robot_health("run", "--thresholds", calm, "--duration", "0.5")
    assert process.wait() == 0


def test_a_duration_with_alerts_ends_with_code_1(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless, "--duration", "1.0")
    assert process.wait() == 1
    assert "battery_level WARN: " in process.text


@pytest.mark.newest_python
def test_an_interrupt_before_the_end_of_the_duration_is_no_judgement(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless, "--duration", "1000")
    process.wait_for_text("battery_level ERROR: ")
    process.signal()
    assert process.wait() == 0


@pytest.mark.newest_python
def test_the_robot_can_be_named(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless, "--json", "--robot", "bolt")
    assert json.loads(process.wait_for_line(lambda line: line.startswith("{")))["robot"] == "bolt"


@pytest.mark.newest_python
def test_source_host_reads_this_machine(robot_health: Start, tmp_path: Path) -> None:
    pytest.importorskip("psutil")
    file = tmp_path / "host.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {cpu_usage: {warn_below: 101.0}}}}\n")
    process = robot_health("run", "--thresholds", file, "--source", "host", "--json")
    transition = json.loads(process.wait_for_line(lambda line: line.startswith("{")))
    assert transition["to_level"] == "WARN"
    assert 0.0 <= transition["value"] <= 100.0


@pytest.mark.newest_python
def test_log_level_hides_the_log_but_no_alert(robot_health: Start, restless: Path) -> None:
    process = robot_health("run", "--thresholds", restless, "--log-level", "ERROR")
    process.wait_for_text("battery_level OK: ")
    assert "[INFO]" not in process.text
    assert "battery_level WARN: " in process.text


def test_it_ends_when_its_reader_exits(command: list[str], environment: dict[str, str], restless: Path) -> None:
    run = [*command, "run", "--thresholds", str(restless)]
    with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        process.stdout.close()  # as `| head -1` does
        assert process.wait(30.0) == 0
        assert process.stderr.read() == b""


@pytest.mark.parametrize("arguments", [["--version"], ["run", "--log-level", "DEBUG"]])
def test_a_reader_that_has_left_before_the_first_line_is_no_error(
    command: list[str], environment: dict[str, str], arguments: Any
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*command, *arguments], stdout=writer, stderr=subprocess.PIPE, env=environment, timeout=30.0, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("arguments", [["--log-level", "FATAL"], ["--json"]])
def test_it_ends_without_a_reader_even_when_it_has_nothing_to_say(
    command: list[str], environment: dict[str, str], calm: Path, arguments: Any
) -> None:
    run = [*command, "run", "--thresholds", str(calm), *arguments]
    with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.wait(30.0) == 0
        assert b"Error" not in process.stderr.read()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_below_stdout_does_not_stop_the_monitoring(
    command: list[str], environment: dict[str, str], robot_health: Start, restless: Path, free_port: int
) -> None:
    run = [*command, "run", "--thresholds", str(restless), "--port", str(free_port)]
    with open("/dev/full", "w") as full, subprocess.Popen(
        run, stdout=full, stderr=subprocess.PIPE, env=environment
    ) as process:
        watcher = robot_health("connect", f"ws://127.0.0.1:{free_port}", "--thresholds", restless)
        watcher.wait_for_text("battery_level ERROR: ")
        watcher.wait_for_text("battery_level OK: ")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30.0) == 0
        assert process.stderr is not None
        problem = "stdout cannot be written (No space left on device): lines may be lost"
        assert process.stderr.read().decode() == f"robot-health: {problem}; monitoring continues\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_judgement_that_could_not_be_written_is_code_3(
    command: list[str], environment: dict[str, str], restless: Path
) -> None:
    with open("/dev/full", "w") as full:
        run = [*command, "run", "--thresholds", str(restless), "--duration", "1"]
        done = subprocess.run(run, stdout=full, stderr=subprocess.PIPE, env=environment, timeout=30.0, check=False)
    assert done.returncode == 3
    assert done.stderr.decode().splitlines()[-1] == (
        "robot-health: stdout cannot be written (No space left on device): lines may be lost"
    )


def test_a_pipe_that_is_not_read_stops_neither_the_monitoring_nor_the_end(
    command: list[str], environment: dict[str, str], robot_health: Start, restless: Path, free_port: int
) -> None:
    reader, writer = os.pipe()
    fill(writer)
    run = [*command, "run", "--thresholds", str(restless), "--port", str(free_port)]
    with subprocess.Popen(run, stdout=writer, stderr=subprocess.PIPE, env=environment) as process:
        os.close(writer)
        watcher = robot_health("connect", f"ws://127.0.0.1:{free_port}", "--thresholds", restless)
        watcher.wait_for_text("battery_level ERROR: ")
        watcher.wait_for_text("battery_level OK: ")
        process.send_signal(signal.SIGTERM)
        assert process.wait(30.0) == 0
        assert process.stderr is not None and process.stderr.read() == b""
    os.close(reader)


@pytest.mark.parametrize("number", ENDING_SIGNALS)
def test_it_ends_while_clients_reconnect_at_once(robot_health: Start, calm: Path, free_port: int, number: int) -> None:
    process = robot_health("run", "--thresholds", calm, "--port", free_port)
    process.wait_for_text("serving on")
    connected, ended = threading.Event(), threading.Event()

    def reconnect() -> None:
        while not ended.is_set():
            try:
                with socket.create_connection(("127.0.0.1", free_port), 5.0) as client:
                    client.sendall(HANDSHAKE)
                    while client.recv(65536):
                        connected.set()
            except OSError:
                pass  # refused or reset: at once again

    clients = [threading.Thread(target=reconnect) for _ in range(5)]
    for client in clients:
        client.start()
    try:
        assert connected.wait(30.0)
        process.signal(number)
        assert process.wait() == 0
    finally:
        ended.set()
        for client in clients:
            client.join(30.0)
    assert not process.errors


def path_without(library: str, folder: Path) -> str:
    """Returns a PYTHONPATH with this project, on which a library is not installed."""
    missing = f"raise ModuleNotFoundError(\"No module named '{library}'\", name='{library}')\n"
    (folder / f"{library}.py").write_text(missing)
    return f"{folder}{os.pathsep}{Path(__file__).resolve().parents[3]}"


@pytest.mark.newest_python
def test_without_cbor2_clients_talk_json_and_one_that_requests_cbor_gets_one_line(
    robot_health: Start, restless: Path, tmp_path: Path, free_port: int
) -> None:
    path = path_without("cbor2", tmp_path)
    process = robot_health("run", "--thresholds", restless, "--port", free_port, PYTHONPATH=path)
    process.wait_for_text("serving on")
    watcher = robot_health("connect", f"ws://127.0.0.1:{free_port}", "--thresholds", restless, PYTHONPATH=path)
    watcher.wait_for_text("battery_level ERROR: ")
    replies = []

    async def request_cbor() -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"ws://127.0.0.1:{free_port}") as socket:
            for request in (
                {"op": "set_level", "level": "error"},
                {"op": "subscribe", "topic": "/battery_level", "compression": "cbor", "id": "bytes"},
                {"op": "subscribe", "topic": "/battery_level", "id": "text"},
            ):
                await socket.send_str(json.dumps(request))
            replies.extend([await socket.receive_json(timeout=30.0) for _ in range(2)])

    asyncio.run(request_cbor())
    status, message = replies
    assert (status["op"], status["level"], status["id"]) == ("status", "error", "bytes")
    assert status["msg"].startswith("subscribe: compression cbor: cbor2 is not installed: ")
    assert list(message["msg"]) == ["data"]
    for each in (watcher, process):
        each.signal()
        assert each.wait() == 0
        assert not each.errors and "cbor2" not in each.text


def test_without_aiohttp_it_monitors_and_says_what_is_missing(
    robot_health: Start, restless: Path, tmp_path: Path
) -> None:
    process = robot_health("run", "--thresholds", restless, "--port", 0, PYTHONPATH=path_without("aiohttp", tmp_path))
    process.wait_for_text(
        "[ERROR] alert_system: server: web page and rosbridge are off: aiohttp is not installed: pip install aiohttp"
    )
    process.wait_for_text("battery_level OK: ")
    process.signal()
    assert process.wait() == 0
    assert process.text.count("web page and rosbridge are off") == 1 and not process.errors


@pytest.mark.newest_python
def test_a_default_port_in_use_disables_only_the_server(robot_health: Start, restless: Path, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        file = tmp_path / "port.yaml"
        file.write_text(re.sub(r"rosbridge_port: \d+", f"rosbridge_port: {port}", restless.read_text()))
        process = robot_health("run", "--thresholds", file)
        off = "[ERROR] alert_system: server: web page and rosbridge are off: "
        process.wait_for_text(f"{off}port {port} of 127.0.0.1 cannot be opened")
        process.wait_for_text("battery_level OK: ")
        requested = robot_health("run", "--thresholds", restless, "--port", port)
        assert requested.wait() == 2
        assert [line.stream for line in requested.lines] == ["err"]
        assert f"port {port} of 127.0.0.1 cannot be opened" in requested.errors[0]


@pytest.mark.newest_python
def test_the_token_file_of_the_configuration_protects_the_server(
    robot_health: Start, restless: Path, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    token.write_text("s3cret\n")
    token.chmod(0o644)
    file = tmp_path / "token.yaml"
    file.write_text(restless.read_text().replace("robot_name: atlas", f"rosbridge_token_file: {token}"))
    process = robot_health("run", "--thresholds", file, "--port", 0)
    process.wait_for_text(f"[WARN] rosbridge: {token}: every user of this machine can read this token")
    url = process.wait_for_text("serving on ws://").rpartition(" ")[2]
    stranger = robot_health("connect", url, "--thresholds", restless, ROBOT_HEALTH_TOKEN="guessed")
    stranger.wait_for_text("check this computer's settings")
    friend = robot_health("connect", url, "--thresholds", restless, "--robot-token-file", token)
    friend.wait_for_text("battery_level ERROR: ")
    assert "s3cret" not in process.text + stranger.text + friend.text


@pytest.mark.parametrize("arguments", [["run"], ["connect", "ws://robot:9090"]])
@pytest.mark.parametrize("token", [["--token", "s3cret"], ["--token=s3cret"]])
def test_a_token_is_no_argument_and_is_not_repeated(robot_health_here: Start, arguments: Any, token: Any) -> None:
    process = robot_health_here(*arguments, *token)
    assert process.wait() == 2
    assert len(process.lines) == 1 and "token-file or ROBOT_HEALTH_TOKEN" in process.errors[0]
    assert "s3cret" not in process.text


def test_a_token_file_that_cannot_be_read_is_one_line_and_code_2(robot_health_here: Start, tmp_path: Path) -> None:
    process = robot_health_here("run", "--token-file", tmp_path / "nowhere")
    assert process.wait() == 2
    assert [(line.stream, line.text) for line in process.lines] == [
        ("err", f"{tmp_path}/nowhere: token cannot be read: No such file or directory")
    ]


@pytest.mark.newest_python
def test_source_none_publishes_nothing(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "none.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {cpu_usage: {startup_grace_s: 0.5}}}}\n")
    process = robot_health("run", "--thresholds", file, "--source", "none", "--port", 0)
    process.wait_for_text("cpu_usage STALE: ")
    assert "battery_sensor" not in process.text


def test_it_runs_without_a_stdout(command: list[str], environment: dict[str, str], restless: Path) -> None:
    run = " ".join([*command, "run", "--thresholds", str(restless), "--duration", "1"])
    done = subprocess.run(
        ["sh", "-c", f"{run} >&-"], stderr=subprocess.PIPE, env=environment, timeout=30.0, check=False
    )
    assert (done.returncode, done.stderr) == (1, b"")


@pytest.mark.newest_python
def test_a_character_that_the_output_does_not_know_costs_no_line(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "celsius.yaml"
    file.write_text(
        "alert_system: {ros__parameters: {signals: {temperature: {unit: °C, warn_above: 10.0}}}}\n", encoding="utf-8"
    )
    process = robot_health("run", "--thresholds", file, PYTHONIOENCODING="ascii")
    assert r"\xb0C is above 10 \xb0C" in process.wait_for_text("temperature WARN: ")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["run", "--bogus"], "robot-health run: unrecognized arguments: --bogus; see robot-health run --help"),
        (
            ["run", "--duration", "soon"],
            "robot-health run: argument --duration: expected a number of seconds above 0, got 'soon'; "
            "see robot-health run --help",
        ),
        (
            ["run", "--duration", "nan"],
            "robot-health run: argument --duration: expected a number of seconds above 0, got 'nan'; "
            "see robot-health run --help",
        ),
        (["run", "--thresholds", "nowhere.yaml"], "nowhere.yaml: cannot be read: No such file or directory"),
    ],
)
def test_wrong_usage_is_one_line_on_stderr_and_code_2(robot_health_here: Start, arguments: Any, line: str) -> None:
    process = robot_health_here(*arguments)
    assert process.wait() == 2
    assert [(each.stream, each.text) for each in process.lines] == [("err", line)]


def test_a_wrong_configuration_ends_it_before_it_has_started_anything(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("alert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n        warn_below: low\n")
    process = robot_health("run", "--thresholds", file)
    assert process.wait() == 2
    key = "alert_system.ros__parameters.signals.battery_level.warn_below"
    assert [(each.stream, each.text) for each in process.lines] == [
        ("err", f"{file}:5: {key}: expected a number, got 'low'")
    ]


def test_without_pyyaml_it_says_what_is_missing(robot_health: Start, calm: Path, tmp_path: Path) -> None:
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "yaml.py").write_text("raise ModuleNotFoundError(\"No module named 'yaml'\", name='yaml')\n")
    process = robot_health(
        "run", "--thresholds", calm, PYTHONPATH=f"{hidden}{os.pathsep}{Path(__file__).resolve().parents[3]}"
    )
    assert process.wait() == 3
    assert [each.text for each in process.lines] == ["robot-health: PyYAML is not installed: pip install PyYAML"]


def test_sighup_reads_the_thresholds_again(robot_health: Start, calm: Path) -> None:
    robot = robot_health("run", "--thresholds", calm, "--port", 0)
    robot.wait_for_text("serving on")
    calm.write_text(calm.read_text().replace("warn_below: 20.0", "warn_below: 99.9"))
    os.kill(robot.pid, signal.SIGHUP)
    robot.wait_for_texts("[INFO] alert_system: reloaded: battery_level.warn_below: 20 -> 99.9", "is below 99.9 %")
    calm.write_text(calm.read_text().replace("warn_below", "warn_belw"))
    os.kill(robot.pid, signal.SIGHUP)
    assert f"{calm}:7: " in robot.wait_for_text("[ERROR] alert_system: not reloaded, the old configuration")
    robot.signal()
    assert robot.wait() == 0


@pytest.mark.newest_python
def test_a_storm_of_sighups_ends_with_the_last_file_and_nothing_lost(robot_health: Start, calm: Path) -> None:
    robot = robot_health("run", "--thresholds", calm, "--port", 0)
    robot.wait_for_text("serving on")
    good = calm.read_text()
    for number in range(100):  # every third file is wrong, and files change while they are read
        calm.write_text(good.replace("warn_below: 20.0", f"warn_b{'elow' if number % 3 else 'elw'}: {number}.5"))
        os.kill(robot.pid, signal.SIGHUP)
    calm.write_text(good.replace("warn_below: 20.0", "warn_below: 99.9"))
    os.kill(robot.pid, signal.SIGHUP)
    robot.wait_for_texts("-> 99.9", "is below 99.9 %")
    assert "internal error" not in robot.text and "Traceback" not in robot.text
    robot.signal()
    assert robot.wait() == 0


@pytest.mark.newest_python
def test_with_an_ops_yaml_alerts_are_stored_and_survive_a_restart(
    robot_health: Start, tmp_path: Path, free_port: int
) -> None:
    ops, low = tmp_path / "ops.yaml", tmp_path / "low.yaml"
    ops.write_text(f"history: {{file: history.db}}\nserver: {{port: {free_port}}}\n")
    low.write_text(
        "alert_system: {ros__parameters: {robot_name: atlas, signals: {battery_level: {warn_below: 101.0}}}}\n"
        "battery_sensor: {ros__parameters: {publish_rate: 20.0}}\n"
    )
    first = robot_health("run", "--ops", ops, "--thresholds", low)
    first.wait_for_text("operations: history, server")
    first.wait_for_text(" battery_level WARN: ")
    first.signal()
    assert first.wait() == 0
    second = robot_health("run", "--ops", ops, "--thresholds", low, "--duration", 2)
    assert second.wait() == 0, second.text  # no alert: it is the one of before
    assert f"serving on ws://127.0.0.1:{free_port}" in second.text
    assert " battery_level WARN" not in second.text


def test_a_wrong_ops_yaml_ends_it_before_it_has_started_anything(
    robot_health_here: Start, calm: Path, tmp_path: Path
) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("notify: {chat: {type: webhook}}\n")
    process = robot_health_here("run", "--ops", file, "--thresholds", calm)
    assert process.wait() == 2
    assert process.text == f"err: {file}:1: notify.chat: expected either url or url_file, got neither"


def test_the_configuration_may_name_the_ops_yaml(robot_health_here: Start, tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text(f"alert_system: {{ros__parameters: {{ops: {tmp_path}/nowhere.yaml, signals: {{arm: {{}}}}}}}}\n")
    process = robot_health_here("run", "--thresholds", file)
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/nowhere.yaml: cannot be read: No such file or directory"


def test_sighup_reads_the_token_again_and_a_revoked_one_is_refused_at_once(
    robot_health: Start, calm: Path, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    token.write_text("first-token-of-this-server")
    token.chmod(0o600)
    robot = robot_health("run", "--thresholds", calm, "--port", 0, "--token-file", token)
    url = robot.wait_for_text("serving on ws://").rpartition(" ")[2]
    watcher = robot_health("connect", url, "--thresholds", calm, "--robot-token-file", token)
    watcher.wait_for_text("connected to")
    copy = tmp_path / "copy"
    copy.write_text("second-token-of-this-server")
    token.unlink()
    copy.rename(token)
    os.kill(robot.pid, signal.SIGHUP)
    robot.wait_for_text("reloaded: server: the token changed, every client has to present the new one")
    watcher.wait_for_text("check this computer's settings: wrong token")  # it has not read its file again
    os.kill(watcher.pid, signal.SIGHUP)
    watcher.wait_for_text("connecting again")
    watcher.wait_for_text("link OK: up")
    token.write_text("two words")
    os.kill(robot.pid, signal.SIGHUP)
    assert f"{token}: expected one token" in robot.wait_for_text("[ERROR] alert_system: not reloaded")
    watcher.signal()
    robot.signal()
    assert (watcher.wait(), robot.wait()) == (0, 0)


@pytest.mark.newest_python
def test_a_token_from_a_pipe_does_not_block_a_reload(robot_health: Start, calm: Path, tmp_path: Path) -> None:
    fifo = tmp_path / "token"
    os.mkfifo(fifo)
    robot = robot_health("run", "--thresholds", calm, "--port", 0, "--token-file", fifo)
    fifo.write_text("a-token-from-a-pipe")
    robot.wait_for_text("serving on")
    for bound in ("30.0", "40.0"):
        calm.write_text(re.sub(r"warn_below: [0-9.]+", f"warn_below: {bound}", calm.read_text()))
        os.kill(robot.pid, signal.SIGHUP)
        robot.wait_for_text("reloaded: battery_level.warn_below: ")
