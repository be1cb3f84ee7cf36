"""Files below /proc, /sys and /run of typical computers of robots, for `Machine`.

None was captured from a device: all are written from documentation, by the kernel's Documentation/hwmon and
Documentation/ABI/testing, proc(5), the firmware's documentation of the Raspberry Pi, and NVIDIA's of L4T. Numbers are
made up, but plausible, and different from one another, so that no value can be taken for another.
"""

from __future__ import annotations

from typing import Mapping

HWMON, THERMAL, POWER, NET = "/sys/class/hwmon", "/sys/class/thermal", "/sys/class/power_supply", "/sys/class/net"


def memory(total_kb: int, available_kb: int, swap_kb: int, swap_free_kb: int, oom_kills: int) -> dict[str, str]:
    return {
        "/proc/meminfo": f"MemTotal: {total_kb} kB\nMemFree: {available_kb // 2} kB\nMemAvailable: {available_kb} kB\n"
        f"Buffers: 1000 kB\nCached: {available_kb // 3} kB\nShmem: 10 kB\nActive: 1 kB\nInactive: 1 kB\n"
        f"SwapTotal: {swap_kb} kB\nSwapFree: {swap_free_kb} kB",
        "/proc/vmstat": f"nr_free_pages 1000\npswpin 0\npswpout 0\noom_kill {oom_kills}\nnr_unstable 0",
        "/proc/zoneinfo": "Node 0, zone      DMA\n        low      28",
    }


def interfaces(**counters: str) -> dict[str, str]:
    """Returns /proc/net/dev of interfaces with `received sent errors dropped`, the latter two both ways."""
    lines = [
        "Inter-|   Receive                                                |  Transmit",
        " face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls "
        "carrier compressed",
    ]
    for name, text in counters.items():
        received, sent, errors, dropped = text.split()
        lines.append(f"{name:>6}: {received} 9 {errors} {dropped} 0 0 0 0 {sent} 8 {errors} {dropped} 0 0 0 0")
    return {"/proc/net/dev": "\n".join(lines)}


def links(**links: str) -> dict[str, str]:
    """Returns the files of interfaces below /sys: `type carrier`."""
    tree = {}
    for name, text in links.items():
        kind, carrier = text.split()
        tree.update({f"{NET}/{name}/type": kind, f"{NET}/{name}/carrier": carrier, f"{NET}/{name}/mtu": "1500"})
    return tree


def disks(**requests: str) -> dict[str, str]:
    """Returns /proc/diskstats of disks with `reads read_ms writes write_ms`."""
    lines = []
    for minor, (name, text) in enumerate(requests.items()):
        reads, read_ms, writes, write_ms = text.split()
        lines.append(f" 8 {minor} {name} {reads} 0 80 {read_ms} {writes} 0 90 {write_ms} 0 50 60")
    return {"/proc/diskstats": "\n".join(lines)}


def chip(number: int, name: str, **inputs: str) -> dict[str, str]:
    """Returns a chip of hwmon: `fan1="1200"`, or with a label: `in1="5040 VDD_IN"`."""
    folder = f"{HWMON}/hwmon{number}"
    tree = {f"{folder}/name": name}
    for sensor, text in inputs.items():
        value, _, label = text.partition(" ")
        tree[f"{folder}/{sensor}_input"] = value
        if label:
            tree[f"{folder}/{sensor}_label"] = label
    return tree


def pressure(cpu: str, memory: str, io: str) -> dict[str, str]:
    return {
        f"/proc/pressure/{resource}": f"some avg10={avg10} avg60=0.10 avg300=0.01 total=123\n"
        "full avg10=0.00 avg60=0.00 avg300=0.00 total=0"
        for resource, avg10 in (("cpu", cpu), ("memory", memory), ("io", io))
    }


def wireless(name: str, level: str) -> dict[str, str]:
    return {
        "/proc/net/wireless": "Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE\n"
        " face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22\n"
        f" {name}: 0000   54.  {level}.  -256        0      0      0      0     0        0"
    }


RASPBERRY_PI_4: Mapping[str, str] = {
    **memory(3_884_000, 2_913_000, 102_396, 51_198, 1),
    **interfaces(lo="700 700 0 0", eth0="0 0 0 0", wlan0="51000000 7000000 2 31"),
    **links(lo="772 1", eth0="1 0", wlan0="1 1"),
    **wireless("wlan0", "-61"),
    **disks(mmcblk0="1000 4100 500 9000", mmcblk0p1="10 20 0 0", mmcblk0p2="990 4080 500 8980", loop0="1 1 0 0"),
    **chip(0, "cpu_thermal", temp1="81790"),
    f"{HWMON}/hwmon1/name": "rpi_volt",
    f"{HWMON}/hwmon1/in0_lcrit_alarm": "1",
    "/sys/devices/platform/soc/soc:firmware/get_throttled": "50005",
}
"""Of Raspberry Pi OS: too little voltage, throttled, no pressure (the kernel is started with psi=0)."""

JETSON_XAVIER_NX: Mapping[str, str] = {
    **memory(6_894_000, 2_100_000, 3_447_000, 3_447_000, 0),
    **interfaces(lo="9 9 0 0", eth0="3000000 9000000 0 0", can0="8000 9000 12 0", dummy0="0 0 0 0"),
    **links(lo="772 1", eth0="1 1", can0="280 1", dummy0="1 0"),
    **disks(mmcblk0="700 900 300 2100", mmcblk0p1="700 900 300 2100", nvme0n1="50 25 50 75", nvme0n1p1="1 1 1 1"),
    **chip(0, "ina3221x", in1="5040 VDD_IN", in2="4992 VDD_CPU_GPU_CV", in3="5008 VDD_SOC"),
    **chip(1, "pwm-fan", fan1="2930"),
    f"{THERMAL}/thermal_zone0/type": "CPU-therm",
    f"{THERMAL}/thermal_zone0/policy": "step_wise",
    f"{THERMAL}/thermal_zone0/temp": "48500",
    f"{THERMAL}/thermal_zone1/type": "GPU-therm",
    f"{THERMAL}/thermal_zone1/policy": "step_wise",
    f"{THERMAL}/thermal_zone1/temp": "47000",
    f"{THERMAL}/thermal_zone2/type": "PMIC-Die",
    f"{THERMAL}/thermal_zone2/policy": "step_wise",
    f"{THERMAL}/thermal_zone2/temp": "100000",
    "/sys/devices/gpu.0/load": "683",
}
"""Of L4T 32."""

LAPTOP: Mapping[str, str] = {
    **memory(16_100_000, 4_025_000, 8_000_000, 7_200_000, 0),
    **interfaces(lo="5 5 0 0", enp0s31f6="0 0 0 0", wlp3s0="90000000 3000000 0 4", docker0="6 7 0 0"),
    **links(lo="772 1", enp0s31f6="1 0", wlp3s0="1 1", docker0="1 0"),
    **wireless("wlp3s0", "-48"),
    **disks(nvme0n1="9000 1800 4000 2600", nvme0n1p2="9000 1800 4000 2600"),
    **chip(0, "coretemp", temp1="58000 Package id 0", temp2="56000 Core 0", temp3="55000 Core 1"),
    **chip(1, "thinkpad", temp1="57000", fan1="3120", fan2="0"),
    **chip(2, "nvme", temp1="41850 Composite"),
    **pressure("3.21", "0.00", "1.50"),
    f"{POWER}/AC/type": "Mains",
    f"{POWER}/AC/online": "0",
    f"{POWER}/BAT0/type": "Battery",
    f"{POWER}/BAT0/status": "Discharging",
    f"{POWER}/BAT0/capacity": "55",
    f"{POWER}/BAT0/charge_full": "4000000",
    f"{POWER}/BAT0/charge_now": "2200000",
    f"{POWER}/BAT0/current_now": "1150000",
    f"{POWER}/BAT0/voltage_now": "11710000",
}

SERVER: Mapping[str, str] = {
    **memory(131_000_000, 98_250_000, 0, 0, 7),
    **interfaces(lo="1 1 0 0", eno1="800000000 700000000 0 0", eno2="10 20 0 5", bond0="800000010 700000020 0 5"),
    **links(lo="772 1", eno1="1 1", eno2="1 0", bond0="1 1"),
    **disks(sda="4000 20000 6000 90000", sda1="1 1 1 1", sdb="10 5 10 5", md0="5 0 5 0", **{"dm-0": "1 1 1 1"}),
    **chip(0, "coretemp", temp1="44000 Package id 0", temp2="43000 Core 0"),
    **chip(1, "power_meter"),
    **pressure("12.00", "0.25", "35.75"),
}
"""Of a rack: its fans are known to the BMC only (IPMI), so the kernel has none."""

MACHINES: Mapping[str, Mapping[str, str]] = {
    "Raspberry Pi 4": RASPBERRY_PI_4,
    "Jetson Xavier NX": JETSON_XAVIER_NX,
    "laptop": LAPTOP,
    "server": SERVER,
}
