"""Network interfaces: traffic, carrier, Wi-Fi and CAN from captured files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors import network
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.source import NoSuchSensor, NotMeasuredYet, SensorError

psutil = pytest.importorskip("psutil")

WIRELESS = """Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan0: 0000   54.  -56.  -256        0      0      0      0      0        0
 wlan1: 0000   20.   186.  -256        0      0      0      0      0        0
 wlan2: 0000    0.     0.  -256        0      0      0      0      0        0
 odd"""


def counters(**interfaces: str) -> dict[str, str]:
    """Returns /proc/net/dev: `received sent errors`."""
    lines = ["Inter-|   Receive  |  Transmit", " face |bytes packets errs drop fifo frame compressed multicast|bytes"]
    for name, text in interfaces.items():
        received, sent, errors = text.split()
        lines.append(f"{name:>6}: {received} 10 {errors} 0 0 0 0 0 {sent} 20 0 0 0 0 0 0")
    return {"/proc/net/dev": "\n".join(lines)}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_traffic_is_in_mb_per_s_without_the_loopback(machine: Machine) -> None:
    machine(counters(lo="0 0 0", eth0="1000000 0 0", wlan0="0 0 0"))
    both = HOST_SOURCES["network_receive"].make(machine.computer)
    sent = HOST_SOURCES["network_send"].make(machine.computer, interface="wlan0")
    loopback = HOST_SOURCES["network_send"].make(machine.computer, interface="lo")
    for each in (both, sent, loopback):
        with pytest.raises(NotMeasuredYet):
            each.read(0.0)
    machine(counters(lo="90000000 90000000 0", eth0="3000000 0 0", wlan0="1000000 500000 0"))
    assert (both.read(2.0), sent.read(2.0), loopback.read(2.0)) == (1.5, 0.25, 45.0)


def test_carrier_is_that_of_one_interface_or_of_any(machine: Machine) -> None:
    machine({"/sys/class/net/lo/carrier": "1", "/sys/class/net/eth0/carrier": "0"})
    assert network.carrier(machine.paths, "") == 0.0
    machine({"/sys/class/net/wlan0/carrier": "1", "/sys/class/net/eth1/type": "1"})  # eth1 is down: no carrier to read
    assert network.carrier(machine.paths, "") == 1.0
    assert network.carrier(machine.paths, "eth0") == 0.0
    assert network.carrier(machine.paths, "eth1") == 0.0
    with pytest.raises(SensorError, match=r"no network interface eth7; available: eth0, eth1, lo, wlan0$"):
        network.carrier(machine.paths, "eth7")


def test_a_machine_with_the_loopback_only_has_no_carrier(machine: Machine) -> None:
    machine({"/sys/class/net/lo/carrier": "1"})
    with pytest.raises(NoSuchSensor, match=r"^this machine has no network interface$"):
        network.carrier(machine.paths, "")
    assert network.carrier(machine.paths, "lo") == 1.0  # if it is asked for by its name


def test_wifi_signal_is_in_dbm_however_the_driver_writes_it(machine: Machine) -> None:
    machine({"/proc/net/wireless": WIRELESS})
    assert list(network.wifi_signals(machine.paths)) == ["wlan0", "wlan1", "wlan2"]
    assert network.signal_dbm(machine.paths, "") == -56.0
    assert network.signal_dbm(machine.paths, "wlan1") == -70.0  # 186 is a byte with a sign
    with pytest.raises(SensorError, match=r"^wlan2 is not connected: its signal reads 0 dBm$"):
        network.signal_dbm(machine.paths, "wlan2")
    with pytest.raises(SensorError, match=r"no Wi-Fi interface wlan3; available: wlan0, wlan1, wlan2$"):
        network.signal_dbm(machine.paths, "wlan3")


@pytest.mark.parametrize("metric", ["wifi_signal", "wifi_bitrate"])
def test_a_machine_without_wifi_is_no_alert(machine: Machine, metric: str) -> None:
    source = HOST_SOURCES[metric].make(machine.computer, interface="")
    with pytest.raises(NoSuchSensor, match=r"^no Wi-Fi interface in "):
        source.read(0.0)
    machine({"/proc/net/wireless": "Inter-| sta-|\n face | tus |"})
    with pytest.raises(NoSuchSensor, match=r"^no Wi-Fi interface in "):
        source.read(10.0)


def test_bitrate_is_asked_of_the_kernel(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    machine({"/proc/net/wireless": WIRELESS.replace("wlan0", "   lo")})
    with pytest.raises(SensorError, match=r"^the Wi-Fi cannot be read: OSError: .*(not supported|Inappropriate ioctl)"):
        HOST_SOURCES["wifi_bitrate"].make(machine.computer).read(0.0)  # the kernel itself: the loopback has none

    def answer(file: int, request: int, argument: bytes) -> bytes:
        assert request == 0x8B21
        assert argument[:16].rstrip(b"\0") == b"wlan1"
        return argument[:16] + struct.pack("=iBBH", 866_700_000, 0, 0, 0) + bytes(8)

    monkeypatch.setattr(fcntl, "ioctl", answer)
    assert network.bitrate(machine.paths, "wlan1") == pytest.approx(866.7)


def test_can_errors_are_those_of_can_interfaces(machine: Machine) -> None:
    tree: dict[str, Any] = {"/sys/class/net/can0/type": "280", "/sys/class/net/eth0/type": "1"}
    machine(tree, counters(can0="0 0 5", eth0="0 0 900"))
    every = HOST_SOURCES["can_errors"].make(machine.computer)
    wrong = HOST_SOURCES["can_errors"].make(machine.computer, interface="eth0")
    with pytest.raises(NotMeasuredYet):
        every.read(0.0)
    with pytest.raises(SensorError, match=r"no CAN interface eth0; available: can0$"):
        wrong.read(0.0)
    machine(counters(can0="0 0 25", eth0="0 0 990"))
    assert every.read(2.0) == 10.0


def test_a_machine_without_can_is_no_alert(machine: Machine) -> None:
    machine(counters(eth0="0 0 0"), {"/sys/class/net/eth0/type": "1"})
    with pytest.raises(NoSuchSensor, match=r"^this machine has no CAN interface$"):
        HOST_SOURCES["can_errors"].make(machine.computer).read(0.0)
