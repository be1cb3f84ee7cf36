"""A real ROS master for the tests of this folder, on a free port of the loopback interface."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping

import pytest
from harness import reserved
from harness.line_process import LineProcess

ROOT = Path(__file__).resolve().parents[2]


def pytest_collection_modifyitems(items: Any) -> None:
    """Skips this folder where there is no ROS 1, and says so."""
    try:
        import rospy  # noqa: F401
    except ImportError as error:
        reason = f"ROS 1 is not here: {error}"
    else:
        if shutil.which("roscore"):
            return
        reason = "ROS 1 is not here: there is no roscore"
    for item in items:
        if os.path.dirname(item.path) == os.path.dirname(__file__):
            item.add_marker(pytest.mark.skip(reason=reason))


class Master:
    """A roscore with its own port, home and logs."""

    def __init__(self, folder: Any, port: int) -> None:
        self.uri = f"http://127.0.0.1:{port}"
        self.environment = {
            **os.environ,
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
            "PYTHONUNBUFFERED": "1",
        }
        for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):
            self.environment.pop(name, None)
        with open(folder / "roscore.txt", "wb") as output:
            self._process = subprocess.Popen(
                ["roscore", "-p", str(port)],
                env=self.environment,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._wait_until_ready()

    def _wait_until_ready(self) -> None:
        import rosgraph

        pause = threading.Event()
        for _ in range(600):
            assert self._process.poll() is None, f"roscore ended with {self._process.returncode}"
            # rosout is the last that roscore starts
            try:
                rosgraph.Master("/tests", self.uri).lookupNode("/rosout")
                return
            except OSError:
                pass
            except rosgraph.MasterException:
                pass
            pause.wait(0.05)
        raise AssertionError("roscore is not ready after 30 s")

    def end(self) -> None:
        """Ends roscore and the master and rosout that it started."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(20)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()


@pytest.fixture(scope="session")
def master(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Master]:
    master = Master(tmp_path_factory.mktemp("ros1"), reserved.free_port())
    try:
        yield master
    finally:
        master.end()


@pytest.fixture
def free_port() -> int:
    return reserved.free_port()


@pytest.fixture
def start_master(tmp_path: Path) -> Iterator[Callable[[int], Master]]:
    """Starts a master of the test's own."""
    masters: list[Master] = []

    def start_on(port: int) -> Master:
        masters.append(Master(tmp_path, port))
        return masters[-1]

    yield start_on
    for master in masters:
        master.end()


@pytest.fixture
def parameters(master: Master) -> Iterator[Callable[[str, Any], None]]:
    """Sets parameters on the master; after the test it has those that it had before."""
    import rosgraph

    server = rosgraph.Master("/tests", master.uri)
    before = set(server.getParam("/"))
    yield server.setParam
    for name in set(server.getParam("/")) - before:
        server.deleteParam(f"/{name}")


@pytest.fixture
def start(master: Master, parameters: Any) -> Iterator[Callable[..., LineProcess]]:
    """Starts an executable of `ros1_executables.py` from the source tree and ends it after the test."""
    processes: list[LineProcess] = []

    def start_executable(function: str, *arguments: str, environment: Mapping[str, str] | None = None) -> LineProcess:
        code = f"import sys; from robot_health_monitor.cli.ros1_executables import {function}; sys.exit({function}())"
        variables: dict[str, str] = {**master.environment, "PYTHONPATH": _with_root(), **(environment or {})}
        processes.append(LineProcess([sys.executable, "-c", code, *arguments], variables))
        return processes[-1]

    yield start_executable
    for process in processes:
        process.end()


def _with_root() -> str:
    return os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))


@pytest.fixture(scope="session")
def ros_process(master: Master) -> Iterator[Master]:
    """Makes the test's own process a node under simulated time, which a process can become only once."""
    import rospy

    before = dict(os.environ)
    os.environ.update(master.environment)
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.pop("ROS_NAMESPACE", None)
    rospy.set_param("/use_sim_time", True)
    rospy.init_node("tests", argv=["tests"], disable_signals=True)
    rospy.delete_param("/use_sim_time")
    try:
        yield master
    finally:
        rospy.signal_shutdown("the tests are over")
        os.environ.clear()
        os.environ.update(before)
