"""Each source of this machine under the restrictions of the shipped units, with the mounts that systemd would make."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Iterator, Mapping

import pytest
from harness.packaging_workspace import ROOT

pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("unshare") or not shutil.which("setpriv"),
    reason="only root can mount what systemd would",
)

UNITS = sorted((ROOT / "resource").glob("robot-health*.service"))

MOUNTS: Mapping[str, str] = {
    "ProtectProc=invisible": "mount -t proc -o hidepid=invisible proc /proc",
    "ProtectProc=noaccess": "mount -t proc -o hidepid=noaccess proc /proc",
    "PrivateDevices=yes": "mount -t tmpfs tmpfs /dev && mknod -m 666 /dev/null c 1 3",
    "ProtectHome=yes": "mount -t tmpfs -o ro,mode=0 tmpfs /home",
    "ProtectHome=read-only": "mount --bind /home /home && mount -o remount,bind,ro /home",
    "ProtectSystem=strict": "mount -o remount,bind,ro /",
    "ProtectKernelTunables=yes": "mount --bind /sys /sys && mount -o remount,bind,ro /sys",
}
"""What systemd mounts for a line of a unit (systemd.exec(5))."""

READ = """
import io, json
from robot_health_monitor.cli.commands.sources_command import show_sources
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Computer
stream, found = io.StringIO(), {}
show_sources(True, stream, Computer())
for each in map(json.loads, stream.getvalue().splitlines()):
    value, _ = each.pop("value"), each.pop("problem")
    if "process" not in each["source"]:
        found[str(each)] = value
def uptime():
    return open("/proc/uptime").read().split()[0]
for kind in ("process_running", "process_memory", "process_cpu_percent", "process_threads"):
    source = HOST_SOURCES[kind].make(Computer(), command="sleep 86399.5")
    for now_s in (0.0, 1.0):
        try:
            found[kind] = source.read(now_s)
        except Exception as error:
            found[kind] = None
        read_at = uptime()
        while uptime() == read_at:  # two reads within its 10 ms are one
            pass
print(json.dumps(found))
"""


@pytest.fixture
def other_users_process() -> Iterator[None]:
    """A process of another user."""
    process = subprocess.Popen(["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", "sleep", "86399.5"])
    yield
    process.kill()
    process.wait()


def sources(folder: Path, *mounts: str) -> dict[str, float]:
    """Returns what each source reads in a mount namespace, without capabilities; None: nothing."""
    code = folder / "read.py"
    code.write_text(READ)
    unprivileged = "setpriv --regid=65533 --clear-groups --bounding-set=-all --inh-caps=-all --no-new-privs"
    read = f"exec {unprivileged} {sys.executable} {code}"
    script = " && ".join([*filter(None, mounts), read])
    command = ["unshare", "--mount", "--propagation", "private", "sh", "-c", script]
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))  # a sourced ROS may have psutil
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True, timeout=60)
    found: dict[str, float] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_every_source_reads_under_the_unit_what_it_reads_without(
    unit: Path, tmp_path: Path, other_users_process: None
) -> None:
    lines = unit.read_text("utf-8").splitlines()
    mounts = [mount for line, mount in MOUNTS.items() if line in lines]
    known = re.compile(r"(Protect(Proc|Home|System)|PrivateDevices|ProcSubset)=")
    assert [line for line in lines if known.match(line) and line not in MOUNTS] == []
    for _ in range(5):  # on a busy machine, a metric that needs two reads may lack one of them
        free, restricted = sources(tmp_path), sources(tmp_path, *mounts)
        changed = differences(free, restricted)
        if not changed:
            break
    assert {"process_running", "process_memory"} - {name for name, value in free.items() if value is not None} == set()
    assert changed == set()


def differences(free: Mapping[str, float], restricted: Mapping[str, float]) -> set[str]:
    """Returns the sources with a value in one of two readings only, or with two where none changes by itself."""
    exact = ("disk_read_only", "process_running")
    return {
        name
        for name, value in free.items()
        if (value is None) != (restricted.get(name) is None)
        or (any(each in name for each in exact) and value != restricted[name])
    }


def test_a_unit_that_hides_processes_would_be_found(tmp_path: Path, other_users_process: None) -> None:
    """The negative of the test above: such mounts do hide something here."""
    found = sources(tmp_path, MOUNTS["ProtectProc=invisible"])
    assert found["process_running"] is None and found["process_memory"] is None
