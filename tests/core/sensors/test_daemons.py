"""What chrony, systemd-timesyncd and systemd answer: real daemons where they are installed."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Callable

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors import daemons
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.daemons import Clock, read_chrony, read_clock
from robot_health_monitor.core.sensors.source import NoSuchSensor, SensorError

FOLDERS = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/bin"])
CHRONYD, CHRONYC, DBUS, BUSCTL = (
    shutil.which(name, path=FOLDERS) for name in ("chronyd", "chronyc", "dbus-daemon", "busctl")
)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


# Chrony: a chronyc that prints what the real one does, and the real one of a real daemon.


def known(is_synchronized: bool, offset_ms: float | None) -> Clock:
    return {"clock_synchronized": float(is_synchronized), "clock_offset_ms": offset_ms}


TRACKING = "C0000201,192.0.2.1,3,1700000000.1,{offset},0.000001,0.000002,1.234,0.001,0.02,0.03,0.004,64.2,{leap}"
"""As client.c of chrony prints it: the offset is positive if this clock is behind ("slow of NTP time")."""


@pytest.fixture
def chronyc(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Puts a chronyc that runs a script in front of the PATH; returns the file with its arguments."""
    return tool(machine, monkeypatch, "chronyc")


def tool(machine: Machine, monkeypatch: pytest.MonkeyPatch, name: str) -> Callable[[str], Path]:
    folder = machine.root / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    def put(script: str) -> Path:
        (folder / name).write_text(f"#!/bin/sh\nprintf '%s\\n' \"$@\" > {folder}/arguments\n{script}\n")
        (folder / name).chmod(0o755)
        return folder / "arguments"

    return put


@pytest.mark.parametrize(
    ("offset", "leap", "clock"),
    [
        ("0.250000000", "Normal", known(True, 250.0)),
        ("-0.250000000", "Normal", known(True, -250.0)),
        ("0.000000000", "Insert second", known(True, 0.0)),
        ("0.000000000", "Not synchronised", known(False, None)),
    ],
)
def test_what_chronyc_prints_is_read(chronyc: Callable[[str], Path], offset: str, leap: str, clock: Clock) -> None:
    arguments = chronyc(f"echo '{TRACKING.format(offset=offset, leap=leap)}'")
    assert read_chrony() == clock
    assert arguments.read_text().split() == ["-n", "-c", "tracking"]


@pytest.mark.parametrize("script", ["", "echo '506 Cannot talk to daemon'; exit 1", "echo ,,,,", "printf '\\377'"])
def test_without_an_answer_of_chronyd_nothing_is_read(chronyc: Callable[[str], Path], script: str) -> None:
    chronyc(script)
    assert read_chrony() is None


def test_without_chronyc_nothing_is_read(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(machine.root / "nowhere"))
    assert read_chrony() is None


@pytest.mark.skipif(not (CHRONYD and CHRONYC), reason="chrony is not installed")
def test_a_real_chronyd_is_read(tmp_path: Path) -> None:
    assert CHRONYD is not None and CHRONYC is not None
    if os.geteuid() != 0:
        pytest.skip("chronyd runs as root only")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lines = [f"cmdport {port}", "port 0", f"bindcmdaddress {tmp_path}/sock", f"pidfile {tmp_path}/pid", "user root"]
    (tmp_path / "chrony.conf").write_text("\n".join([*lines, "local stratum 8", ""]))
    tmp_path.chmod(0o700)
    daemon = subprocess.Popen([CHRONYD, "-d", "-x", "-f", str(tmp_path / "chrony.conf")], stderr=subprocess.PIPE)
    try:
        found = None
        ends_s = time.monotonic() + 20.0
        while found is None and time.monotonic() < ends_s:
            found = read_chrony("-p", str(port), "-h", "127.0.0.1")
            if daemon.poll() is not None:
                assert daemon.stderr is not None
                pytest.skip(f"chronyd does not run here: {daemon.stderr.read()[-200:]!r}")
        assert found is not None
        assert found["clock_synchronized"] == 1.0  # its own clock is its reference
        assert found["clock_offset_ms"] == pytest.approx(0.0, abs=1.0)
    finally:
        daemon.terminate()
        daemon.wait()
        assert daemon.stderr is not None
        daemon.stderr.close()


# D-Bus: a busctl that prints what the real one does, and the real one on a real bus.


@pytest.fixture
def busctl(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Puts a busctl that runs a script in front of the PATH; returns the file with its arguments."""
    (run_folder(machine) / "dbus").mkdir()
    (run_folder(machine) / "dbus" / "system_bus_socket").touch()
    return tool(machine, monkeypatch, "busctl")


def run_folder(machine: Machine) -> Path:
    return Path(machine.paths.run)


def test_the_failed_units_are_a_property_of_systemd(machine: Machine, busctl: Callable[[str], Path]) -> None:
    arguments = busctl("echo u 2")
    assert daemons.failed_units(machine.paths) == 2.0
    assert arguments.read_text().split() == [
        f"--address=unix:path={machine.paths.run}/dbus/system_bus_socket", "--auto-start=no", "--timeout=2",
        "get-property", "org.freedesktop.systemd1", "/org/freedesktop/systemd1", "org.freedesktop.systemd1.Manager",
        "NFailedUnits",
    ]  # fmt: skip


@pytest.mark.parametrize("printed", ["u", "u 2 3", "", "u x"])
def test_an_answer_that_is_not_systemds_is_an_error(
    machine: Machine, busctl: Callable[[str], Path], printed: str
) -> None:
    busctl(f"echo {printed}")
    with pytest.raises(SensorError, match=r"^systemd cannot be read: ValueError: ") as caught:
        HOST_SOURCES["systemd_failed"].make(machine.computer).read(0.0)
    assert not isinstance(caught.value, NoSuchSensor)


def test_a_computer_without_systemd_is_no_alert(
    machine: Machine, busctl: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    busctl("echo 'Failed to get property: no such name' >&2; exit 1")
    with pytest.raises(NoSuchSensor, match=r"^busctl: Failed to get property"):
        daemons.failed_units(machine.paths)
    monkeypatch.setenv("PATH", str(machine.root / "nowhere"))
    with pytest.raises(NoSuchSensor, match=r"^busctl cannot be run: No such file or directory$"):
        daemons.failed_units(machine.paths)


@pytest.mark.skipif(not (DBUS and BUSCTL), reason="dbus-daemon or busctl is not installed")
def test_a_real_bus_says_that_systemd_is_not_there(machine: Machine) -> None:
    (run_folder(machine) / "dbus").mkdir()
    address = f"unix:path={run_folder(machine)}/dbus/system_bus_socket"
    arguments = [str(DBUS), "--session", "--nofork", "--nopidfile", f"--address={address}", "--print-address"]
    daemon = subprocess.Popen(arguments, stdout=subprocess.PIPE)
    try:
        assert daemon.stdout is not None
        assert daemon.stdout.readline().startswith(b"unix:path=")
        with pytest.raises(NoSuchSensor, match=r"^busctl: .*systemd1"):
            daemons.failed_units(machine.paths)
    finally:
        daemon.terminate()
        daemon.wait()
        assert daemon.stdout is not None
        daemon.stdout.close()


# systemd-timesyncd.


def test_timesyncd_says_in_a_file_that_the_clock_is_synchronized(machine: Machine) -> None:
    with pytest.raises(NoSuchSensor, match=r"^no time daemon: chronyc reaches none, and there is no "):
        read_clock(machine.paths)
    folder = run_folder(machine) / "systemd" / "timesync"
    folder.mkdir(parents=True)
    assert read_clock(machine.paths) == known(False, None)
    with pytest.raises(SensorError, match=r"^clock_offset_ms has not been measured yet$") as caught:
        HOST_SOURCES["clock_offset_ms"].make(machine.computer).read(0.0)
    assert not isinstance(caught.value, NoSuchSensor)
    (folder / "synchronized").touch()
    assert read_clock(machine.paths) == known(True, None)


def test_the_offset_of_timesyncd_is_that_of_its_latest_answer(machine: Machine, busctl: Callable[[str], Path]) -> None:
    (run_folder(machine) / "systemd" / "timesync").mkdir(parents=True)
    # Sent at 1.000 s, received at 1.260 s and answered at 1.261 s of the server's time, here again at 1.021 s.
    head = "(uuuuittayttttbtt) 0 4 4 2 -24 30517 167846 4 193 67 79 114"
    busctl(f"echo '{head} 1000000 1260000 1261000 1021000 false 12 34'")
    assert read_clock(machine.paths) == known(False, 250.0)
    for odd in ("", head, f"{head} 0 0 0 0 false 0 0", "(uuuuittayttttbtt) 0 4 4 2 -24 1 1 x"):
        busctl(f"echo '{odd}'")
        assert read_clock(machine.paths) == known(False, None)
