"""The packages that `make deb` has built in dist/debian: lintian, and each of them installed, started and purged.

Each is installed into a new minimal Debian 12. What this does not show: systemd itself, Ubuntu, and the packages of
Jazzy and of ROS One, which no archive here has. In their place are rclpy's wheels and Debian's ROS 1.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Iterator

import pytest
from harness.debian_root import DebianRoot
from harness.packaging_workspace import NAME, NODES, ROOT, source_modules, version
from harness.requirements import ROS2_WHEELS
from harness.reserved import free_port, ros2_domain

DIST = ROOT / "dist" / "debian"

pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("mmdebstrap"), reason="a new Debian needs root and mmdebstrap"
)


def built(pattern: str) -> Path:
    (package,) = DIST.glob(pattern)
    return package


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DebianRoot]:
    made = DebianRoot(tmp_path_factory.mktemp("debian") / "root")
    yield made
    made.close()


@pytest.fixture
def clean(root: DebianRoot) -> Iterator[DebianRoot]:
    """Checks after the test that nothing of the project is left; what it depends on may stay."""
    yield root
    assert {name for name in root.users() if "robot" in name} == set()
    assert {file for file in root.files() if "robot-health" in file or NAME in file} == set()


@pytest.mark.parametrize("package", [file.name for file in sorted(DIST.glob("*.deb"))])
def test_lintian_finds_no_error(package: str) -> None:
    lintian = ["lintian", "--allow-root", "--fail-on", "error", "--tag-display-limit", "0"]
    done = subprocess.run([*lintian, str(DIST / package)], stdout=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stdout


class Service:
    """The service as systemd starts it (`Type=notify`), without systemd: its user, umask and command."""

    def __init__(self, root: DebianRoot) -> None:
        unit = (root.folder / "lib/systemd/system/robot-health.service").read_text()
        (started,) = re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE)
        (user,) = re.findall(r"^User=(.*)$", unit, re.MULTILINE)
        self.notifications = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notifications.settimeout(60.0)
        folder = os.open(root.folder / "tmp", os.O_RDONLY)
        self.notifications.bind(f"/proc/self/fd/{folder}/notify")  # the path itself may be too long
        os.close(folder)
        os.chmod(root.folder / "tmp" / "notify", 0o777)
        variables = {"NOTIFY_SOCKET": "/tmp/notify", "WATCHDOG_USEC": "2000000"}
        ids = [f"--reuid={user}", f"--regid={user}", "--init-groups"]
        self.process = root.start(*started.split(), variables=variables, user=ids)

    def wait_for(self, state: bytes) -> None:
        while self.notifications.recv(4096) != state:
            pass

    def stop(self) -> str:
        self.process.terminate()
        output, _ = self.process.communicate(timeout=60.0)
        assert self.process.returncode == 0, output
        return output


def test_apt_install_gives_a_running_silent_service_and_purge_leaves_nothing(clean: DebianRoot) -> None:
    clean.install(built("robot-health_*_all.deb"))
    assert clean.run("robot-health", "--version").strip() == f"robot-health {version()}"
    modules = clean.folder / "usr/share/robot-health" / NAME
    assert sorted(str(file.relative_to(modules)) for file in modules.rglob("*.py")) == [
        name for name in source_modules() if name.endswith(".py")
    ]
    port = free_port()
    ops = clean.folder / "etc/robot-health/ops.yaml"
    ops.write_text(re.sub(r"^  port: 9099$", f"  port: {port}", ops.read_text(), flags=re.MULTILINE))

    service = Service(clean)
    service.wait_for(b"READY=1")
    for _ in range(5):
        service.wait_for(b"WATCHDOG=1")
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=30.0) as answer:
        assert json.load(answer) == {"ok": True, "faults": []}
    output = service.stop()
    assert "[ERROR]" not in output and "Traceback" not in output
    assert not re.search(r" (WARN|ERROR|STALE): ", output), output
    entries = clean.run("robot-health", "history", "/var/lib/robot-health/history.db").splitlines()
    assert [re.sub(r".*(started|in force|stopped).*", r"\1", entry) for entry in entries] == [
        "started",
        "in force",
        "stopped",
    ]

    for secret in (
        "etc/robot-health/chat.url",
        "etc/robot-health/north/fleet.yaml",
        "var/lib/robot-health-north/history.db",
    ):
        (clean.folder / secret).parent.mkdir(exist_ok=True)
        (clean.folder / secret).touch()
    clean.purge("robot-health")


def test_conffiles_are_kept_when_the_package_is_removed_and_the_user_when_it_is_installed_again(
    clean: DebianRoot,
) -> None:
    package = built("robot-health_*_all.deb")
    clean.install(package)
    conffiles = clean.run("dpkg-query", "--show", "--showformat", "${Conffiles}", "robot-health").split()
    assert [name for name in conffiles if name.startswith("/")] == [
        "/etc/robot-health/ops.yaml",
        "/etc/robot-health/thresholds.yaml",
    ]
    ops = clean.folder / "etc/robot-health/ops.yaml"
    ops.write_text("history: {file: /var/lib/robot-health/mine.db}\n")
    (clean.folder / "var/lib/robot-health/mine.db").touch()
    clean.run("dpkg", "--remove", "robot-health")
    assert not (clean.folder / "usr/bin/robot-health").exists()
    clean.install(package, "--reinstall")
    assert ops.read_text() == "history: {file: /var/lib/robot-health/mine.db}\n"
    assert (clean.folder / "var/lib/robot-health/mine.db").exists()
    clean.purge("robot-health")


def test_systemd_accepts_the_units(clean: DebianRoot) -> None:
    clean.install(built("robot-health_*_all.deb"))
    clean.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", "systemd")
    units = clean.folder / "lib/systemd/system"
    assert clean.run("systemd-analyze", "verify", *(f"/lib/systemd/system/{unit}" for unit in names(units))) == ""
    for unit in names(units):
        # 0 is best; 2.0 is where systemd ends to say OK for a service that needs the network.
        options = ["security", "--offline=true", "--threshold=20", "--no-pager"]
        clean.run("systemd-analyze", *options, f"/lib/systemd/system/{unit}")
    clean.purge("robot-health")


def names(units: Path) -> list[str]:
    return sorted(unit.name for unit in units.glob("robot-health*.service"))


def check_launch(root: DebianRoot, variables: dict[str, str]) -> None:
    """Starts the launch file and waits until all nodes have said what they do."""
    port = free_port()
    ros = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": f"/tmp/ros{port}"}
    launch = root.start("roslaunch", "-p", str(port), NAME, "health_monitor.launch", variables={**ros, **variables})
    wait_for_lines(launch, ["watching battery_level", "system_health is the mean", 'sensor "robot" started'])


def wait_for_lines(process: subprocess.Popen[str], wanted: list[str]) -> None:
    """Reads the output until it has each of these texts; then ends the process, which must be a clean end."""
    left, output = set(wanted), []
    assert process.stdout is not None
    for line in process.stdout:
        output.append(line)
        left -= {text for text in left if text in line}
        if not left:
            break
    assert not left, "".join(output)
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=60.0)
    assert process.returncode == 0 and "Traceback" not in rest, rest


def test_the_nodes_for_debians_own_ros_1(clean: DebianRoot) -> None:
    clean.install(built("robot-health-monitor_*.deb"))
    assert clean.run("robot-health", "--version").strip() == f"robot-health {version()}"
    for node in NODES:
        assert (clean.folder / "usr/lib" / NAME / node).stat().st_mode & 0o111
    check_launch(clean, {})
    refused = clean.run("dpkg", "--install", f"/tmp/{built('robot-health_*_all.deb').name}", fails=True)
    assert "conflicts with robot-health" in refused or "conflicting packages" in refused
    clean.purge("robot-health-monitor")


def test_the_nodes_for_ros_one(clean: DebianRoot) -> None:
    """With Debian's ROS 1 in the place of /opt/ros/one."""
    clean.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", "python3-roslaunch", *python_packages())
    clean.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", *message_packages())
    clean.unpack(built("ros-one-robot-health-monitor_*.deb"))
    prefix = clean.folder / "opt/ros/one"
    assert list(prefix.rglob("*.pyc")), "users of robots cannot write them there"
    (prefix / ".catkin").touch()  # of the package ros-one-catkin: where roslaunch looks for nodes
    check_launch(
        clean,
        {
            "PYTHONPATH": "/opt/ros/one/lib/python3/dist-packages",
            "ROS_PACKAGE_PATH": "/opt/ros/one/share",
            "CMAKE_PREFIX_PATH": "/opt/ros/one",
        },
    )
    (prefix / ".catkin").unlink()
    clean.purge("ros-one-robot-health-monitor")


def test_the_nodes_for_jazzy(clean: DebianRoot) -> None:
    """With rclpy from PyPI in /opt/ros/jazzy, for the Python of this Debian."""
    clean.run("apt-get", "-qq", "install", "-y", "--no-install-recommends", *python_packages())
    clean.unpack(built("ros-jazzy-robot-health-monitor_*.deb"))
    prefix = clean.folder / "opt/ros/jazzy"
    (library,) = (prefix / "lib").glob("python3*")
    packages = library / "site-packages"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--ignore-installed", "--no-warn-script-location"]
    assert library.name == f"python3.{sys.version_info.minor}", "the wheels must be those for Debian's Python"
    subprocess.run([*pip, "--prefix", str(prefix), *ROS2_WHEELS], check=True)
    libraries = [prefix / "lib", *packages.glob("*.libs")]
    variables = {
        "AMENT_PREFIX_PATH": "/opt/ros/jazzy",
        "LD_LIBRARY_PATH": ":".join(f"/{folder.relative_to(clean.folder)}" for folder in libraries),
        "PYTHONPATH": f"/{packages.relative_to(clean.folder)}",
        "ROS_DOMAIN_ID": str(ros2_domain("debs")),
        "ROS_LOCALHOST_ONLY": "1",
        "ROS_LOG_DIR": "/tmp/ros2",
    }
    node = clean.start(f"/opt/ros/jazzy/lib/{NAME}/health_monitor", variables=variables)
    wait_for_lines(node, ["watching battery_level", "system_health is the mean", 'sensor "robot" started'])
    clean.purge("ros-jazzy-robot-health-monitor")
    assert not [path for path in prefix.rglob("*robot_health*") if "__pycache__" not in path.parts]
    shutil.rmtree(clean.folder / "opt/ros")


def python_packages() -> list[str]:
    depends = subprocess.run(
        ["dpkg-deb", "--field", str(built("ros-jazzy-*.deb")), "Depends"], stdout=subprocess.PIPE, text=True, check=True
    ).stdout
    return [name.strip() for name in depends.split(",") if name.strip().startswith("python3-")]


def message_packages() -> list[str]:
    depends = subprocess.run(
        ["dpkg-deb", "--field", str(built("robot-health-monitor_*.deb")), "Depends"],
        stdout=subprocess.PIPE, text=True, check=True,
    ).stdout  # fmt: skip
    return [name.strip() for name in depends.split(",") if name.strip().startswith("python3-")]
