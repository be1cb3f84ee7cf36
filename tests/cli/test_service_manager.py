"""What systemd receives: a datagram socket in a folder, or in the abstract namespace, as systemd's own."""

from __future__ import annotations

import os
import re
import select
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Iterator

import pytest

from robot_health_monitor.cli.arguments import parse
from robot_health_monitor.cli.service_manager import ServiceManager
from robot_health_monitor.core.port.local import LocalBus


class Systemd:
    """The socket of a service manager."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.setblocking(False)

    def environment(self, **more: str) -> dict[str, str]:
        return {"NOTIFY_SOCKET": self.address, **more}

    def received(self) -> list[str]:
        """Returns what has come since the last call."""
        found = []
        while select.select([self._socket], [], [], 0.0)[0]:
            found.append(self._socket.recv(1000).decode())
        return found

    def wait_for(self, state: str, timeout_s: float = 30.0) -> None:
        """Waits until a state has come."""
        end_s = time.monotonic() + timeout_s
        while select.select([self._socket], [], [], end_s - time.monotonic())[0]:
            if self._socket.recv(1000).decode() == state:
                return
        pytest.fail(f"no {state} within {timeout_s:g} s")

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def systemd(request: Any, tmp_path: Path) -> Iterator[Systemd]:
    name = f"robot-health-{os.getpid()}"
    found = Systemd(f"@{name}" if request.param == "abstract" else os.path.relpath(tmp_path / name))
    yield found
    found.close()


def test_the_start_and_the_end_are_reported(systemd: Systemd) -> None:
    manager = ServiceManager(systemd.environment())
    manager.ready()
    manager.stopping()
    assert systemd.received() == ["READY=1", "STOPPING=1"]


def test_signs_of_life_come_at_least_twice_per_watchdog_interval(systemd: Systemd) -> None:
    bus = LocalBus(start_s=100.0)
    ServiceManager(systemd.environment(WATCHDOG_USEC="10000000")).watch(bus.node("monitor"), lambda: 0.5)
    times = []
    for step in range(1, 300):
        bus.run_due(100.0 + 0.1 * step)
        times += [0.1 * step for state in systemd.received() if state == "WATCHDOG=1"]
    assert times == pytest.approx([2.5 * number for number in range(1, 12)], abs=0.11)


def test_signs_of_life_are_at_least_a_tenth_of_a_second_apart(systemd: Systemd) -> None:
    bus = LocalBus(start_s=100.0)
    ServiceManager(systemd.environment(WATCHDOG_USEC="1")).watch(bus.node("monitor"), lambda: 0.5)
    bus.run_until(100.55)
    assert systemd.received() == ["WATCHDOG=1"] * 5


def test_without_ticks_there_is_no_sign_of_life(systemd: Systemd) -> None:
    bus, age_s = LocalBus(start_s=100.0), 10.5
    ServiceManager(systemd.environment(WATCHDOG_USEC="10000000")).watch(bus.node("monitor"), lambda: age_s)
    bus.run_due(103.0)
    assert systemd.received() == []
    age_s = 9.5
    bus.run_due(106.0)
    assert systemd.received() == ["WATCHDOG=1"]


@pytest.mark.parametrize(
    "variables",
    [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}],
)
def test_a_process_that_is_not_watched_sends_no_signs_of_life(systemd: Systemd, variables: dict[str, str]) -> None:
    bus = LocalBus(start_s=100.0)
    ServiceManager(systemd.environment(**variables)).watch(bus.node("monitor"), lambda: 0.0)
    assert bus.next_due_s() is None


def test_commands_that_are_started_do_not_inherit_the_socket() -> None:
    environment = {"NOTIFY_SOCKET": "@x", "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1", "PATH": "/bin"}
    ServiceManager(environment)
    assert environment == {"PATH": "/bin"}


@pytest.mark.parametrize("address", ["/nonexistent/socket", "@nobody-listens", "a\0b", "/" + "x" * 200])
def test_a_socket_that_cannot_be_reached_does_no_harm(address: str) -> None:
    bus = LocalBus(start_s=100.0)
    manager = ServiceManager({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000000"})
    manager.watch(node := bus.node("monitor"), lambda: 0.0)
    manager.ready()
    bus.run_due(101.0)
    manager.stopping()
    assert not node.faults.current() and not bus.log_lines


def test_a_manager_that_does_not_read_delays_nothing(systemd: Systemd) -> None:
    manager = ServiceManager(systemd.environment())
    for _ in range(5000):
        manager.ready()
    assert 0 < len(systemd.received()) < 5000


@pytest.mark.parametrize("systemd", ["path"], indirect=True)
@pytest.mark.parametrize("command", [("run", "--port", "0"), ("connect", "robot=ws://127.0.0.1:1")])
def test_a_command_reports_its_start_its_life_and_its_end(systemd: Systemd, command: Any, tmp_path: Path) -> None:
    environment = {**os.environ, **systemd.environment(WATCHDOG_USEC="400000"), "HOME": str(tmp_path)}
    systemd_path = os.path.abspath(systemd.address)
    environment["NOTIFY_SOCKET"] = systemd_path
    process = subprocess.Popen(
        [sys.executable, "-m", "robot_health_monitor", *command], env=environment, stdout=subprocess.DEVNULL
    )
    try:
        systemd.wait_for("READY=1")
        systemd.wait_for("WATCHDOG=1")
        systemd.wait_for("WATCHDOG=1")
        process.terminate()
        systemd.wait_for("STOPPING=1")
        assert process.wait(30.0) == 0
    finally:
        process.kill()
        process.wait()


UNIT = Path(__file__).resolve().parents[2] / "resource" / "robot-health.service"


TEMPLATE = UNIT.with_name("robot-health@.service")


@pytest.fixture(params=[UNIT, TEMPLATE], ids=["unit", "template"])
def unit(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A unit, with a command that exists here; of the template, an instance."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    text, replaced = re.subn(
        r"(?m)^ExecStart=\S+", f"ExecStart={sys.executable}", request.param.read_text(encoding="utf-8")
    )
    assert replaced == 1
    file = tmp_path / request.param.name.replace("@", "@north")
    file.write_text(text, encoding="utf-8")
    return file


def test_systemd_accepts_the_unit(unit: Path) -> None:
    run = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], stderr=subprocess.PIPE, text=True, timeout=60
    )
    assert [line for line in run.stderr.splitlines() if unit.name in line] == []
    assert run.returncode == 0, run.stderr


def test_the_unit_is_hardened(unit: Path) -> None:
    command = ["systemd-analyze", "security", "--offline=true", "--threshold=20", str(unit)]  # in tenths
    run = subprocess.run(command, capture_output=True, text=True, timeout=60)
    if "unrecognized option" in run.stderr:
        pytest.skip("systemd-analyze before 250 cannot judge a file")
    assert run.returncode == 0, run.stdout[-500:]


def test_an_instance_of_the_template_has_its_own_files_and_the_restrictions_of_the_unit() -> None:
    unit, template = (file.read_text(encoding="utf-8").splitlines() for file in (UNIT, TEMPLATE))

    (hardening,) = (number for number, line in enumerate(unit) if line.startswith("# Hardening."))
    assert {*unit[hardening:]} <= {*template}
    own = [
        line.replace("%i", "north") for line in template if line.startswith(("ExecStart=", "StateDirectory=", "Env"))
    ]
    assert own == [
        "ExecStart=/opt/robot-health/bin/robot-health connect --fleet /etc/robot-health/north/fleet.yaml "
        "--ops /etc/robot-health/north/ops.yaml --port ${PORT}",
        "EnvironmentFile=/etc/robot-health/north/port.env",
        "StateDirectory=robot-health-north",
    ]


def test_the_unit_asks_for_what_the_monitor_reports() -> None:
    lines = UNIT.read_text(encoding="utf-8").splitlines()
    assert {"Type=notify", "Restart=always", "WatchdogSec=30", "User=robot-health", "StateDirectory=robot-health"} < {
        *lines
    }


def test_the_unit_watches_this_machine_and_no_simulated_values() -> None:
    (command,) = re.findall(r"(?m)^ExecStart=(.*)$", UNIT.read_text(encoding="utf-8"))
    program, command_name, *arguments = command.split()
    assert (Path(program).name, command_name) == ("robot-health", "run")
    assert parse([command_name, *arguments]).source == "host"
