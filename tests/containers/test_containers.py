"""The files in containers/: what images are built from, and their health check."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from xml.etree import ElementTree

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
CONTAINERS = ROOT / "containers"
FILES = sorted(CONTAINERS.glob("Containerfile.*"))
ROS_FILES = [file for file in FILES if file.suffix != ".cli"]
CHECK = CONTAINERS / "healthcheck.py"


def check(url: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CHECK)]
    variables = {"ROBOT_HEALTH_CHECK_URL": url}
    return subprocess.run(command, env=variables, capture_output=True, text=True, timeout=60)


def test_the_check_is_ok_while_the_monitor_ticks_and_fails_when_it_is_stopped_or_dead() -> None:
    command = [sys.executable, "-m", "robot_health_monitor", "run", "--port", "0", "--source", "none"]
    command += ["--duration", "100"]
    monitor = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert monitor.stdout
        pages = (re.search(r"web page: (http://\S+)", line) for line in monitor.stdout)
        page = next(found for found in pages if found)
        url = f"{page[1]}healthz"
        assert check(url).returncode == 0
        monitor.send_signal(signal.SIGSTOP)
        stopped = check(url)
        assert stopped.returncode == 1 and "timed out" in stopped.stderr
        monitor.send_signal(signal.SIGCONT)
        assert check(url).returncode == 0
        monitor.kill()
        monitor.wait()
        dead = check(url)
        assert dead.returncode == 1
        assert dead.stderr.startswith(f"{url}: ") and "refused" in dead.stderr and len(dead.stderr.splitlines()) == 1
    finally:
        monitor.kill()
        monitor.communicate()


class _NoTicks(BaseHTTPRequestHandler):
    def do_GET(self) -> None:  # the name that http.server calls
        self.send_error(503)

    def log_message(self, *_: object) -> None:
        pass


def test_the_check_fails_where_the_monitor_does_not_tick() -> None:
    server = HTTPServer(("127.0.0.1", 0), _NoTicks)
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        done = check(f"http://127.0.0.1:{server.server_port}/healthz")
    finally:
        server.shutdown()
        server.server_close()
    assert done.returncode == 1 and "503" in done.stderr


def instructions(file: Path, name: str) -> list[str]:
    joined = re.sub(r"\\\n", " ", file.read_text(encoding="utf-8"))
    return re.findall(rf"^{name} (.*)$", joined, re.MULTILINE)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_an_image_is_not_run_as_root_and_has_a_health_check(file: Path) -> None:
    assert instructions(file, "USER") == ["10001:10001"]
    assert len(instructions(file, "HEALTHCHECK")) == 1
    assert instructions(file, "VOLUME") == ["/var/lib/robot-health"]


@pytest.mark.parametrize("file", ROS_FILES, ids=lambda file: file.name)
def test_an_image_with_ros_has_the_packages_that_the_manifest_names(file: Path) -> None:
    distro, version = file.suffix[1:], {".noetic": "1", ".jazzy": "2"}[file.suffix]
    wanted: set[str] = set()
    for element in ElementTree.parse(ROOT / "package.xml").getroot().iter("exec_depend"):
        if element.get("condition") in (None, f"$ROS_VERSION == {version}"):
            wanted.add(str(element.text))
    base = {"python3", "ament_index_python", "launch", "launch_ros", "rcl_interfaces", "rclpy", "std_msgs"}
    base |= {"genpy", "rosgraph", "roslaunch", "roslib", "rospy"}  # what the images of ROS, or packages below, bring
    (installed,) = (text for text in instructions(file, "RUN") if "apt-get install" in text)
    names = {
        each if each.startswith("python3-") else f"ros-{distro}-{each.replace('_', '-')}" for each in wanted - base
    }
    assert names - set(installed.split()) == set()


def test_the_context_of_a_build_has_every_folder_that_is_installed() -> None:
    allowed = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    folders = re.search(r"^FOLDERS = (\[.*\])", (ROOT / "setup.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert folders
    needed = [*yaml.safe_load(folders[1]), "robot_health_monitor", "config", "launch", "resource"]
    needed += ["setup.py", "package.xml", "pyproject.toml", "CMakeLists.txt", "LICENSE"]
    assert [name for name in needed if f"!{name}" not in allowed] == []
    copied = {source for file in FILES for source in re.findall(r"^COPY (containers/\S+)", file.read_text(), re.M)}
    assert copied and all((ROOT / source).exists() and f"!{source}" in allowed for source in copied)


def test_the_example_for_compose_is_read_only_and_has_no_capabilities() -> None:
    (service,) = yaml.safe_load((CONTAINERS / "compose.yaml").read_text(encoding="utf-8"))["services"].values()
    assert service["read_only"] is True and service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges"]
    assert (CONTAINERS / service["build"]["context"] / service["build"]["dockerfile"]).resolve() in FILES


def test_the_entry_point_sources_the_files_and_becomes_the_command(tmp_path: Path) -> None:
    (tmp_path / "setup.bash").write_text('export SEEN="$SEEN $*"\n', encoding="utf-8")
    (tmp_path / "local_setup.bash").write_text('export SEEN="$SEEN local"\n', encoding="utf-8")
    files = [str(tmp_path / "setup.bash"), str(tmp_path / "local_setup.bash")]
    command = [str(CONTAINERS / "ros_entrypoint.sh"), *files, "sh", "-c", 'echo "$SEEN $1"', "sh", "a b"]
    assert subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout == " -- local a b\n"
