"""Processes as sources: trees of files in virtual time (proc(5)), and real processes beside psutil and ps."""

from __future__ import annotations

import builtins
import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Callable

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors import configuration, processes
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.processes import OLD_SCANS, Processes, node_names
from robot_health_monitor.core.sensors.source import NotMeasuredYet, SensorError
from robot_health_monitor.core.values.errors import ConfigError

AMCL = "/opt/ros/noetic/lib/amcl/amcl scan:=base_scan __name:=amcl __log:=/tmp/amcl.log"


class Robot:
    """A computer with processes, whose time stands still until `at` sets it."""

    def __init__(self, root: Path) -> None:
        self.machine = Machine(root)
        self.proc = root / "proc"
        self.at(1000.0)
        self.runs(1, "/sbin/init")

    def at(self, uptime_s: float) -> None:
        self.now_s = uptime_s
        (self.proc / "uptime").write_text(f"{uptime_s:.2f} 4000.00\n")

    def runs(self, pid: int, command: str, **values: Any) -> None:
        self.machine.runs(pid, command, **values)

    def ends(self, pid: int) -> None:
        shutil.rmtree(self.proc / str(pid))

    def source(self, metric: str, **options: str) -> Callable[[], float]:
        made = HOST_SOURCES[metric].make(self.machine.computer, **options)
        return lambda: made.read(self.now_s)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def reason(read: Callable[[], float]) -> str:
    with pytest.raises(SensorError) as caught:
        read()
    return str(caught.value)


def test_cpu_time_is_in_percent_of_one_core_as_top_shows_it(robot: Robot) -> None:
    cpu = robot.source("process_cpu_percent", command="*/amcl *")
    robot.runs(70, AMCL, cpu_s=3.0)
    with pytest.raises(NotMeasuredYet):
        cpu()
    robot.at(1002.0)
    robot.runs(70, AMCL, cpu_s=6.0)
    assert cpu() == pytest.approx(150.0)  # 3 s of CPU time in 2 s: two threads


@pytest.mark.parametrize(("reduce", "expected"), [("sum", 60.0), ("max", 30.0), ("min", 10.0), ("mean", 20.0)])
def test_several_processes_are_reduced(robot: Robot, reduce: str, expected: float) -> None:
    for pid, mb in ((70, 10.0), (71, 20.0), (72, 30.0)):
        robot.runs(pid, AMCL, mb=mb)
    assert robot.source("process_memory", command="*/amcl *", reduce=reduce)() == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    ("command", "options", "matches"),
    [
        (AMCL, {"command": "*/amcl *"}, True),
        ("/opt/ros/noetic/lib/amcl/amcl", {"command": "*/amcl *"}, True),  # without arguments
        ("/opt/ros/noetic/lib/amcl/amcl", {"command": "*/amcl"}, True),
        ("/opt/ros/noetic/lib/amcl/amcl_2 x", {"command": "*/amcl *"}, False),
        ("/opt/ros/noetic/lib/amcl/amcl_2 x", {"command": "*/amcl_? x"}, True),
        ("/opt/ros/noetic/lib/amcl/amcl x[1]", {"command": "*x[1]"}, True),  # brackets are text
        (AMCL, {"node": "amcl"}, True),
        (AMCL, {"node": "/amcl"}, True),
        (AMCL, {"node": "am*"}, False),
        ("/x/urg_node __name:=front __ns:=/robot1", {"node": "front"}, True),
        ("/x/urg_node __name:=front __ns:=/robot1", {"node": "/robot1/front"}, True),
        ("/x/urg_node __name:=front __ns:=/robot1", {"node": "/robot2/front"}, False),
        ("/x/urg_node __name:=front", {"node": "urg_node"}, False),  # it has another name
        ("/x/lib/nav2/controller_server --ros-args -r __node:=local", {"node": "local"}, True),
        ("/x/component_container --ros-args -r a:__node:=one -r b:__node:=two", {"node": "two"}, True),
        ("/x/lib/nav2/controller_server --ros-args", {"node": "controller_server"}, True),
        ("/usr/bin/python3 -u /x/lib/pkg/talker.py", {"node": "talker.py"}, True),
        (AMCL, {"node": "amcl", "command": "/opt/*"}, True),
        (AMCL, {"node": "amcl", "command": "/home/*"}, False),
    ],
)
def test_a_process_is_selected_by_its_command_line_or_its_node(
    robot: Robot, command: str, options: dict[str, str], matches: bool
) -> None:
    robot.runs(70, command)
    assert robot.source("process_running", **options)() == float(matches)


def test_neither_command_nor_node_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError) as caught:
        configuration.read_sources({"host": {"load": {"source": "process_cpu_percent"}}})
    assert str(caught.value) == "host.load: expected command or node, to select processes"


def test_without_a_process_only_whether_it_runs_is_published(robot: Robot) -> None:
    sources = {metric: robot.source(metric, node="amcl") for metric in processes.METRICS}
    for metric, read in sources.items():
        if metric == "process_running":
            assert read() == 0.0
        else:
            assert reason(read) == "no process matches node amcl"


def test_a_process_that_is_killed_and_restarted_is_counted(robot: Robot) -> None:
    robot.runs(70, AMCL)
    restarts, running = robot.source("process_restarts", node="amcl"), robot.source("process_running", node="amcl")
    assert (restarts(), running()) == (0.0, 1.0)
    robot.ends(70)
    robot.at(1001.0)
    assert running() == 0.0
    robot.runs(80, AMCL, start=100150)
    robot.at(1002.0)
    assert (restarts(), running()) == (1.0, 1.0)


def test_a_process_that_starts_after_the_monitor_has_not_been_restarted(robot: Robot) -> None:
    restarts = robot.source("process_restarts", node="amcl")
    assert reason(restarts) == "no process matches node amcl"
    robot.runs(70, AMCL)
    robot.at(1001.0)
    assert restarts() == 0.0
    robot.runs(71, AMCL)  # a second one beside it
    robot.at(1002.0)
    assert restarts() == 0.0


def test_a_number_that_is_used_again_is_another_process(robot: Robot) -> None:
    robot.runs(70, AMCL, cpu_s=900.0)
    cpu, restarts = robot.source("process_cpu_percent", node="amcl"), robot.source("process_restarts", node="amcl")
    running = robot.source("process_running", node="amcl")
    assert reason(cpu).startswith("not measured yet")
    robot.runs(70, AMCL, start=100050, cpu_s=0.1)
    robot.at(1001.0)
    assert reason(cpu) == "no process matches node amcl"  # the old one has ended; the new one is found next
    robot.at(1002.0)
    assert reason(cpu).startswith("not measured yet")
    assert (restarts(), running()) == (1.0, 1.0)
    robot.runs(70, "/usr/bin/sleep 5", start=100250)  # and now it is not even the same program
    for second in (1003.0, 1004.0):
        robot.at(second)
        assert running() == 0.0


def test_a_process_that_is_replaced_by_exec_is_found(robot: Robot) -> None:
    running = robot.source("process_running", node="amcl")
    assert running() == 0.0
    robot.runs(70, "/usr/bin/python3 /usr/bin/roslaunch robot.launch")  # forked, not yet the node
    robot.at(1001.0)
    assert running() == 0.0
    robot.runs(70, AMCL)
    robot.at(1002.0)
    assert running() == 1.0


def test_an_old_process_that_is_replaced_by_exec_is_found_in_its_turn(robot: Robot) -> None:
    for pid in range(100, 200):
        robot.runs(pid, "/usr/bin/sleep 5")
    running = robot.source("process_running", node="amcl")
    assert running() == 0.0
    robot.runs(150, AMCL)
    found = []
    for second in range(OLD_SCANS):
        robot.at(1001.0 + second)
        found.append(running())
    assert found[-1] == 1.0


def test_a_zombie_and_a_thread_of_the_kernel_do_not_run(robot: Robot) -> None:
    running = robot.source("process_running", command="*")
    robot.ends(1)
    robot.runs(1, "")
    robot.runs(2, "", name="kthreadd")
    robot.runs(70, AMCL)
    amcl = robot.source("process_running", node="amcl")
    assert amcl() == 1.0
    robot.runs(70, "", state="Z", name="amcl")  # its parent does not reap it
    robot.at(1001.0)
    assert reason(amcl).startswith("no visible process matches node amcl")  # nor is process 1 visible
    assert reason(running).startswith("no visible process")


def test_a_process_that_dies_between_listing_and_reading_is_gone(robot: Robot) -> None:
    robot.runs(70, AMCL)
    running = robot.source("process_running", node="amcl")
    assert running() == 1.0
    (robot.proc / "70" / "stat").unlink()
    robot.at(1001.0)
    assert running() == 0.0
    robot.runs(71, AMCL)
    (robot.proc / "71" / "cmdline").unlink()
    robot.at(1002.0)
    assert running() == 0.0


@pytest.mark.parametrize("name", ["a) S 1 (b", "))))", "x y", "\x1b[31m"])
def test_the_name_of_a_process_may_contain_anything(robot: Robot, name: str) -> None:
    robot.runs(70, AMCL, mb=33.0, threads=7, name=name)
    threads, memory = robot.source("process_threads", node="amcl"), robot.source("process_memory", node="amcl")
    assert threads() == 7.0
    assert memory() == pytest.approx(33.0, abs=0.01)


def test_a_command_line_of_a_megabyte_and_one_without_text_are_compared(robot: Robot) -> None:
    robot.runs(70, "/x/amcl " + "a" * 1_000_000)
    robot.runs(71, "/x/amcl tail")
    (robot.proc / "71" / "cmdline").write_bytes(b"/x/\xff\xfe\x1b\0\0\n\0")
    patterns = {"/x/amcl *": 1.0, "*a*a*a*a*a*a*a*a*b": 0.0, "/x/??\x1b*": 1.0}  # the second does not try all ways
    sources = [robot.source("process_running", command=pattern) for pattern in patterns]
    assert [read() for read in sources] == list(patterns.values())


@pytest.mark.newest_python
def test_thousands_of_processes_are_not_read_in_every_period(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    for pid in range(100, 2100):
        robot.runs(pid, "/usr/bin/sleep 5")
    robot.runs(70, AMCL)
    reads = [robot.source(metric, node="amcl") for metric in ("process_memory", "process_threads", "process_running")]
    everything = robot.source("process_memory", command="*")
    running = robot.source("process_running", command="*")
    for read in reads:
        read()
    assert reason(everything) == "2002 processes match command * (limit 200)"
    assert running() == 1.0
    opened: list[str] = []

    def noted(plain: Callable[..., Any]) -> Callable[..., Any]:
        def open_noted(path: Any, *arguments: Any, **options: Any) -> Any:
            opened.append(str(path))
            return plain(path, *arguments, **options)

        return open_noted

    monkeypatch.setattr(builtins, "open", noted(builtins.open))
    monkeypatch.setattr(os, "open", noted(os.open))
    robot.at(1001.0)
    for read in reads:
        read()
    assert {path.rpartition("/")[2] for path in opened if "/70/" in path} >= {"stat", "statm"}
    assert len([path for path in opened if "/70/" in path]) < 10  # however many sources read it
    assert len(opened) < 250


def test_processes_that_are_hidden_from_this_user_are_not_taken_for_ended(robot: Robot) -> None:
    robot.ends(1)  # hidepid=2
    robot.runs(70, "/bin/own")
    assert reason(robot.source("process_running", node="amcl")) == (
        "no visible process matches node amcl: /proc hides those of other users"
    )


def test_the_files_of_another_user_are_named_and_the_rest_is_read(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.runs(70, AMCL, mb=33.0)
    files, memory = robot.source("process_files", node="amcl"), robot.source("process_memory", node="amcl")
    plain = os.listdir

    def refuse(path: Any) -> list[str]:
        if str(path).endswith("/70/fd"):
            raise PermissionError(13, "Permission denied")
        return plain(path)

    monkeypatch.setattr(os, "listdir", refuse)
    assert reason(files) == "process 70 is another user's, who hides this"
    assert memory() == pytest.approx(33.0, abs=0.01)


def test_a_source_that_is_made_within_a_period_waits_for_the_next(robot: Robot) -> None:
    robot.runs(70, AMCL)
    first = robot.source("process_memory", node="map_server")
    assert reason(first) == "no process matches node map_server"
    late = robot.source("process_running", node="amcl")
    with pytest.raises(NotMeasuredYet):
        late()
    robot.at(1001.0)
    assert late() == 1.0


def test_the_load_of_a_process_that_was_replaced_is_not_that_of_the_old_one(robot: Robot) -> None:
    robot.runs(70, AMCL, cpu_s=3.0)
    cpu = robot.source("process_cpu_percent", node="amcl")
    assert reason(cpu).startswith("not measured yet")
    robot.runs(70, AMCL, cpu_s=3.5)
    robot.at(1001.0)
    assert cpu() == pytest.approx(50.0)
    robot.ends(70)
    robot.runs(80, AMCL, start=100150)
    robot.at(1002.0)
    assert reason(cpu).startswith("not measured yet")


def test_sources_of_a_configuration_that_was_replaced_are_dropped(robot: Robot) -> None:
    for number in range(100):
        robot.source("process_running", node=f"node_{number}")
    gc.collect()
    assert len(robot.machine.computer.shared[Processes]._selections) == 0


def test_nodes_are_listed_by_their_names() -> None:
    assert node_names(["/x/amcl"]) == {"amcl", "/amcl"}
    assert node_names([""]) == frozenset()
    assert node_names(["python3"]) == {"python3", "/python3"}


# Real processes.


class Child:
    """A Python program that runs until the end of the test."""

    def __init__(self, code: str, name: str) -> None:
        self.name = name
        self._popen = subprocess.Popen(
            [sys.executable, "-c", code, f"__name:={name}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._popen.pid
        self.order()

    def order(self) -> str:
        """Waits until it has done its work, and lets it go on."""
        assert self._popen.stdin is not None and self._popen.stdout is not None
        return self._popen.stdout.readline()

    def go_on(self) -> str:
        assert self._popen.stdin is not None
        self._popen.stdin.write("\n")
        self._popen.stdin.flush()
        return self.order()

    def end(self) -> None:
        self._popen.send_signal(signal.SIGKILL)
        self._popen.wait()
        for stream in (self._popen.stdin, self._popen.stdout):
            assert stream is not None
            stream.close()


WORKS = """
import sys, threading, time
kept = [open("/dev/null") for _ in range(5)]
threading.Thread(target=threading.Event().wait, daemon=True).start()
print("ready", flush=True)
while sys.stdin.readline():
    kept.append(bytearray(b"x" * 30_000_000))
    begin = time.process_time()
    while time.process_time() - begin < 0.3:
        pass
    print("done", flush=True)
"""


def live(metric: str, computer: Computer, node: str) -> Callable[[float], float]:
    return HOST_SOURCES[metric].make(computer, node=node).read


def test_a_real_process_reads_as_psutil_and_ps_show_it(monkeypatch: pytest.MonkeyPatch) -> None:
    psutil = pytest.importorskip("psutil")
    monkeypatch.setattr(psutil, "PROCFS_PATH", "/proc")  # other tests read other machines
    child = Child(WORKS, f"leaks_and_spins_{os.getpid()}")  # of this run: another may be on this machine
    try:
        computer = Computer()
        read = {metric: live(metric, computer, child.name) for metric in processes.METRICS}
        other = psutil.Process(child.pid)
        before_s = time.monotonic()
        with pytest.raises(NotMeasuredYet):
            read["process_cpu_percent"](0.0)
        memory = read["process_memory"](0.0)
        cpu = other.cpu_times()
        child.go_on()
        busy = other.cpu_times()
        percent = read["process_cpu_percent"](1.0)
        took_s = time.monotonic() - before_s
        assert busy.user + busy.system - cpu.user - cpu.system >= 0.3
        # It cannot have been less than what it used, nor more than the ticks and the time before the first read allow.
        assert 100.0 * 0.25 / took_s <= percent <= 120.0
        grown = read["process_memory"](1.0)
        assert grown - memory >= 29.0
        assert grown == pytest.approx(other.memory_info().rss / 1e6, rel=0.02)
        assert read["process_threads"](1.0) == other.num_threads() == 2
        assert read["process_files"](1.0) == other.num_fds()
        assert read["process_running"](1.0) == 1.0
        ps = shutil.which("ps")
        if ps:
            printed = subprocess.check_output([ps, "-o", "rss=,nlwp=", "-p", str(child.pid)], text=True).split()
            assert grown == pytest.approx(int(printed[0]) * 1024 / 1e6, rel=0.02)
            assert int(printed[1]) == 2
    finally:
        child.end()


def test_a_real_process_that_is_killed_and_restarted_is_seen() -> None:
    computer = Computer()
    name = f"restarted_{os.getpid()}"  # of this run
    running = live("process_running", computer, name)
    restarts = live("process_restarts", computer, name)
    assert running(0.0) == 0.0
    first = Child("import sys; print('ready', flush=True); sys.stdin.read()", name)
    assert (running(1.0), restarts(1.0)) == (1.0, 0.0)
    first.end()
    assert running(2.0) == 0.0
    second = Child("import sys; print('ready', flush=True); sys.stdin.read()", name)
    try:
        assert (running(3.0), restarts(3.0)) == (1.0, 1.0)
    finally:
        second.end()
