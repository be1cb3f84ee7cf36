"""Calls to a real ROS master, and to one that is down or hangs."""

from __future__ import annotations

import socket
from typing import Any, List

import pytest

from robot_health_monitor.core.errors import ServiceError


@pytest.fixture
def connection(master: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    from robot_health_monitor.ros1.master import Master

    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    return Master("/tests")


def test_it_reads_parameters_services_and_topics(connection: Any, parameters: Any) -> None:
    parameters("/some/number", 7)
    assert connection.is_online()
    assert connection.parameter("/some", {}) == {"number": 7}
    assert connection.parameter("/none", "default") == "default"
    assert connection.find_service("/none") is None
    assert connection.find_service("/rosout/get_loggers").startswith("rosrpc://")
    assert connection.topic_types()["/rosout_agg"] == "rosgraph_msgs/Log"
    publishers, _, _ = connection.system_state()
    assert ["/rosout_agg", ["/rosout"]] in publishers


def test_a_master_has_one_identity_and_knows_its_nodes(connection: Any) -> None:
    assert connection.identity("/rosout") == connection.identity("/rosout") is not None
    assert connection.identity("/missing") is None


def test_a_master_that_hangs_is_a_service_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from robot_health_monitor.ros1.master import Master

    with socket.socket() as hanging:
        hanging.bind(("127.0.0.1", 0))
        hanging.listen()
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{hanging.getsockname()[1]}")
        master = Master("/tests", timeout_s=0.1)
        assert not master.is_online()
        with pytest.raises(ServiceError, match="does not answer"):
            master.identity("/tests")


@pytest.mark.parametrize("uri", ["nonsense", "ftp://127.0.0.1:1"])
def test_an_address_that_is_none_is_a_service_error(monkeypatch: pytest.MonkeyPatch, uri: str) -> None:
    from robot_health_monitor.ros1.master import Master

    monkeypatch.setenv("ROS_MASTER_URI", uri)
    with pytest.raises(ServiceError, match="ROS_MASTER_URI"):
        Master("/tests")


class Answers:
    """A master whose answers are given: None: it is down; a list: its identity for each next check."""

    uri = "http://robot:11311"

    def __init__(self, *identities: Any) -> None:
        self._identities = list(identities)

    def identity(self, node: str) -> Any:
        identity = self._identities.pop(0)
        if identity == "down":
            raise ServiceError("the ROS master at http://robot:11311 does not answer (refused)")
        return identity


@pytest.mark.parametrize(
    ("identities", "changes"),
    [
        ([(1, "a"), (1, "a"), None], ["ERROR"]),
        ([(1, "a"), (2, "a")], ["ERROR"]),
        ([(1, "a"), (1, "b")], ["ERROR"]),
        ([(1, "a"), "down", (1, "a"), None], ["OK", "ERROR"]),
        ([(1, "a"), "down", "down", "down", (1, "a"), "down", "down", None], ["WARN", "OK", "WARN", "ERROR"]),
    ],
)
def test_a_loss_is_reported_once_and_a_restart_ends_the_watch(identities: Any, changes: List[str]) -> None:
    from robot_health_monitor.ros1.master import MasterWatch

    seen: List[str] = []
    watch = MasterWatch(Answers(*identities), "/tests", lambda text, level: seen.append(level.name), period_s=0.0)
    watch.start()
    watch.join(10.0)
    assert watch.lost.is_set()
    assert seen == changes
