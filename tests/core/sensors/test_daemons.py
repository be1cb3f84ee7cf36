"""What chrony, systemd-timesyncd and systemd answer: real daemons where they are installed, else literal bytes."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path
from typing import Iterator, List, Tuple

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors import daemons
from robot_health_monitor.core.sensors.daemons import Clock, read_chrony, read_clock
from robot_health_monitor.core.sensors.source import NoSuchSensor, SensorError

FOLDERS = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/bin"])
CHRONYD, CHRONYC, DBUS = (shutil.which(name, path=FOLDERS) for name in ("chronyd", "chronyc", "dbus-daemon"))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


# Chrony.


@contextlib.contextmanager
def udp_peer(answer: bytes) -> Iterator[Tuple[Tuple[str, int], List[bytes]]]:
    """A peer that answers one request on the loopback."""
    requests: List[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(10.0)

        def serve() -> None:
            request, client = server.recvfrom(4096)
            requests.append(request)
            server.sendto(answer, client)

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname(), requests
        thread.join()


def tracking(leap: int, correction: int) -> bytes:
    """Returns an answer as in candm.h: 28 bytes of head, then RPY_Tracking."""
    head = struct.pack("!BBBBHHHHHHIII", 6, 2, 0, 0, 33, 5, 0, 0, 0, 0, 1, 0, 0)
    address = struct.pack("!I", 0xC0000201) + bytes(12) + struct.pack("!HH", 1, 0)
    body = struct.pack("!I", 0xC0000201) + address + struct.pack("!HH", 3, leap) + struct.pack("!III", 0, 1, 2)
    return head + body + struct.pack("!I", correction) + bytes(36)


@pytest.mark.parametrize(
    ("leap", "correction", "clock"),
    [
        (0, 0x01000000 | (1 << 23), None),  # exponent 0: the coefficient has its sign bit set
        (0, (0 << 25) | (1 << 23), Clock(True, 250.0)),  # 2**23 * 2**-25
        (0, (0x7F << 25) | 0x1000000, Clock(True, -250.0)),  # -2**24 * 2**-26
        (1, 0, Clock(True, 0.0)),
        (3, 0, Clock(False, None)),
    ],
)
def test_an_answer_of_chrony_is_read(leap: int, correction: int, clock: Clock) -> None:
    with udp_peer(tracking(leap, correction)) as (address, requests):
        found = read_chrony(address)
    if clock is not None:
        assert found == clock
    assert requests[0][:6] == bytes([6, 1, 0, 0, 0, 33])
    assert len(requests[0]) >= len(tracking(0, 0)) - 4  # a shorter request is not answered


@pytest.mark.parametrize("answer", [b"", b"\x06\x02", tracking(0, 0)[:50], b"\x05" + tracking(0, 0)[1:], b"x" * 200])
def test_an_answer_that_is_not_chronys_is_none(answer: bytes) -> None:
    with udp_peer(answer) as (address, _):
        assert read_chrony(address) is None


def test_without_chrony_nothing_is_read() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    assert read_chrony(address) is None


@pytest.mark.skipif(not (CHRONYD and CHRONYC), reason="chrony is not installed")
def test_a_real_chronyd_reads_as_chronyc_shows_it(tmp_path: Path) -> None:
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
            found = read_chrony(("127.0.0.1", port))
            if daemon.poll() is not None:
                assert daemon.stderr is not None
                pytest.skip(f"chronyd does not run here: {daemon.stderr.read()[-200:]!r}")
        printed = subprocess.check_output([CHRONYC, "-c", "-p", str(port), "-h", "127.0.0.1", "tracking"], text=True)
        fields = printed.strip().split(",")  # ref id, address, stratum, ref time, system time, ...
        assert found is not None
        assert found.is_synchronized is (fields[-1] != "Not synchronised")
        assert (found.offset_ms or 0.0) == pytest.approx(1000.0 * float(fields[4]), abs=1.0)
    finally:
        daemon.terminate()
        daemon.wait()
        assert daemon.stderr is not None
        daemon.stderr.close()


# D-Bus. Literal bytes by the D-Bus specification, "Message Protocol".

HELLO_REPLY = (
    b"l\x02\x01\x01" + struct.pack("<II", 9, 1) + struct.pack("<I", 15)
    + b"\x05\x01u\0" + struct.pack("<I", 1) + b"\x08\x01g\0\x01s\0" + b"\0"
    + struct.pack("<I", 4) + b":1.7\0"
)  # fmt: skip
SIGNAL = b"l\x04\x01\x01" + struct.pack("<II", 9, 2) + struct.pack("<I", 8) + b"\x05\x01u\0" + struct.pack("<I", 1)
SIGNAL += struct.pack("<I", 4) + b":1.7\0"


def reply(body: bytes, kind: int = 2) -> bytes:
    head = b"l" + bytes([kind]) + b"\x01\x01" + struct.pack("<II", len(body), 3) + struct.pack("<I", 8)
    return head + b"\x05\x01u\0" + struct.pack("<I", 2) + body


def ntp_message(origin: int, received: int, transmitted: int, arrived: int) -> bytes:
    """Returns the variant of NTPMessage, (uuuuittayttttbtt), times in microseconds."""
    body = b"\x10(uuuuittayttttbtt)\0"
    body = bytes([len(b"(uuuuittayttttbtt)")]) + body[1:]
    body = body.ljust(-(-len(body) // 8) * 8, b"\0")
    body += struct.pack("<IIIIi", 0, 4, 4, 2, -20) + bytes(4)  # aligned to 8
    body += struct.pack("<QQ", 100, 200) + struct.pack("<I", 4) + b"ABCD"
    body += struct.pack("<QQQQ", origin, received, transmitted, arrived)
    return body + struct.pack("<I", 0) + bytes(4) + struct.pack("<QQ", 5, 6)


class Bus:
    """A bus that answers the second call with given bytes."""

    def __init__(self, run: Path, answer: bytes) -> None:
        (run / "dbus").mkdir()
        self._server = socket.socket(socket.AF_UNIX)
        self._server.bind(str(run / "dbus" / "system_bus_socket"))
        self._server.listen(1)
        self._server.settimeout(10.0)
        self._answer = answer
        self.received = b""
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        client, _ = self._server.accept()
        with client:
            client.settimeout(10.0)
            client.recv(1000)
            client.sendall(b"OK 1234\r\n")
            while b"Get" not in self.received:
                part = client.recv(1000)
                if not part:
                    break
                self.received += part
            client.sendall(HELLO_REPLY + SIGNAL + self._answer)

    def close(self) -> None:
        self._thread.join()
        self._server.close()


@pytest.fixture
def bus(machine: Machine) -> Iterator[List[Bus]]:
    started: List[Bus] = []
    yield started
    for each in started:
        each.close()


def run_folder(machine: Machine) -> Path:
    return Path(machine.paths.run)


def test_the_failed_units_are_a_property_of_systemd(machine: Machine, bus: List[Bus]) -> None:
    bus.append(Bus(run_folder(machine), reply(b"\x01u\0\0" + struct.pack("<I", 2))))
    assert daemons.failed_units(machine.paths) == 2.0
    assert bus[0].received.startswith(b"BEGIN\r\nl\x01\x02\x01")  # little endian, a call, that starts no service
    for text in (b"org.freedesktop.systemd1.Manager\0", b"NFailedUnits\0", b"/org/freedesktop/systemd1\0"):
        assert text in bus[0].received


@pytest.mark.parametrize(
    "answer",
    [
        reply(b"\x01s\0\0" + struct.pack("<I", 2)),
        reply(b"\x01u\0\0\x02"),
        reply(b""),
        b"B" + reply(b"\x01u\0\0\0\0\0\0")[1:],
        b"l\x02\x01\x01" + b"\xff" * 12,
        b"",
        SIGNAL * 30,
    ],
)
def test_an_answer_that_is_not_systemds_is_an_error(machine: Machine, bus: List[Bus], answer: bytes) -> None:
    bus.append(Bus(run_folder(machine), answer))
    with pytest.raises(SensorError, match=r"D-Bus|cut off") as caught:
        daemons.failed_units(machine.paths)
    assert not isinstance(caught.value, NoSuchSensor)


def test_a_computer_without_systemd_is_no_alert(machine: Machine, bus: List[Bus]) -> None:
    with pytest.raises(NoSuchSensor, match=r"^no D-Bus of the system: there is no "):
        daemons.failed_units(machine.paths)
    text = b"The name is not activatable"
    bus.append(Bus(run_folder(machine), reply(struct.pack("<I", len(text)) + text + b"\0", kind=3)))
    with pytest.raises(NoSuchSensor, match=r"^org.freedesktop.systemd1 is not there: The name is not activatable$"):
        daemons.failed_units(machine.paths)


def test_a_bus_that_closes_or_refuses_is_an_error(machine: Machine) -> None:
    (run_folder(machine) / "dbus").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(run_folder(machine) / "dbus" / "system_bus_socket"))
        server.listen(2)
        for answer in (b"", b"REJECTED EXTERNAL\r\n"):

            def serve(answer: bytes = answer) -> None:
                client, _ = server.accept()
                client.sendall(answer)
                client.close()

            thread = threading.Thread(target=serve)
            thread.start()
            with pytest.raises(SensorError, match=r"D-Bus"):
                daemons.failed_units(machine.paths)
            thread.join()


@pytest.mark.skipif(not DBUS, reason="dbus-daemon is not installed")
def test_a_real_bus_says_that_systemd_is_not_there(machine: Machine) -> None:
    (run_folder(machine) / "dbus").mkdir()
    address = f"unix:path={run_folder(machine)}/dbus/system_bus_socket"
    arguments = [str(DBUS), "--session", "--nofork", "--nopidfile", f"--address={address}", "--print-address"]
    daemon = subprocess.Popen(arguments, stdout=subprocess.PIPE)
    try:
        assert daemon.stdout is not None
        assert daemon.stdout.readline().startswith(b"unix:path=")
        with pytest.raises(NoSuchSensor, match=r"^org.freedesktop.systemd1 is not there: .*systemd1"):
            daemons.failed_units(machine.paths)
    finally:
        daemon.terminate()
        daemon.wait()
        assert daemon.stdout is not None
        daemon.stdout.close()


# systemd-timesyncd.


def test_timesyncd_says_in_a_file_that_the_clock_is_synchronized(machine: Machine) -> None:
    with pytest.raises(NoSuchSensor, match=r"^no time daemon: chrony does not answer on 323/udp, and there is no "):
        read_clock(machine.paths)
    folder = run_folder(machine) / "systemd" / "timesync"
    folder.mkdir(parents=True)
    assert read_clock(machine.paths) == Clock(False, None)
    with pytest.raises(SensorError, match=r"^the time daemon has not measured the offset yet$"):
        daemons.clock_offset_ms(read_clock(machine.paths))
    (folder / "synchronized").touch()
    assert read_clock(machine.paths) == Clock(True, None)


def test_the_offset_of_timesyncd_is_that_of_its_latest_answer(machine: Machine, bus: List[Bus]) -> None:
    (run_folder(machine) / "systemd" / "timesync").mkdir(parents=True)
    # Sent at 1.000 s, received at 1.260 s and answered at 1.261 s of the server's time, here again at 1.021 s.
    bus.append(Bus(run_folder(machine), reply(ntp_message(1_000_000, 1_260_000, 1_261_000, 1_021_000))))
    assert read_clock(machine.paths) == Clock(False, 250.0)
