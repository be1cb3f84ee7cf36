"""What every middleware that a rosbridge server can serve promises besides the port.

A test module per middleware subclasses `ServedConformance` and gives it the fixtures `harness`, of
`port_conformance.py`, and `served`, a `ServedMiddleware` called `/bridge` that is closed after the test.
"""

from __future__ import annotations

from typing import Any

import pytest

from harness.port_conformance import FLOAT32, TRIGGER, Harness
from robot_health_monitor.core.port.middleware import ServedMiddleware
from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.core.values.names import split_type_name


class ServedConformance:
    """The promises of `ServedMiddleware`."""

    @pytest.fixture(autouse=True)
    def _close(self, harness: Harness, served: ServedMiddleware) -> Any:
        yield
        served.close()
        harness.close()

    def test_the_graph_lists_nodes_topics_and_services(self, harness: Harness, served: ServedMiddleware) -> None:
        # Names of this test only: a graph may still list a process that has ended.
        node = harness.node("listed")
        node.advertise("published", FLOAT32)
        node.subscribe("heard", FLOAT32, lambda value, now_s: None, field="data")
        node.advertise_service("~reset", TRIGGER, lambda request: {"success": True, "message": ""})
        harness.wait_until(
            lambda: (
                {"/published", "/heard"} <= set(served.graph().topics) and "/listed/reset" in served.graph().services
            )
        )
        graph = served.graph()
        assert list(split_type_name(graph.topics["/published"]) or ()) == ["std_msgs", "Float32"]
        nodes = [name for name, info in graph.nodes.items() if "/published" in info.publishes]
        assert len(nodes) == 1
        assert "/heard" in graph.nodes[nodes[0]].subscribes
        assert "/listed/reset" in graph.nodes[nodes[0]].services

    def test_a_service_is_called_without_knowing_its_type(self, harness: Harness, served: ServedMiddleware) -> None:
        harness.node("alert_system").advertise_service(
            "~enable", "std_srvs/SetBool", lambda request: {"success": request["data"], "message": "seen"}
        )
        harness.wait_until(lambda: "/alert_system/enable" in served.graph().services)
        for flag in (True, False):
            response = served.call_service("/alert_system/enable", "", {"data": flag}, 10.0)
            assert dict(response) == {"success": flag, "message": "seen"}

    def test_a_service_that_is_not_there_is_an_error(self, harness: Harness, served: ServedMiddleware) -> None:
        with pytest.raises(ServiceError, match="/missing/reset"):
            served.call_service("/missing/reset", "", {}, 0.2)
        with pytest.raises(ServiceError, match="/missing/reset"):
            served.call_service("/missing/reset", TRIGGER, {}, 0.2)

    def test_a_definition_holds_those_of_the_types_within(self, harness: Harness, served: ServedMiddleware) -> None:
        if served.raw_format(FLOAT32).message_encoding == "json":
            return  # tests/core/messages/test_raw_messages.py
        assert "float32 data" in served.raw_format(FLOAT32).schema
        text = served.raw_format("diagnostic_msgs/DiagnosticArray").schema
        parts = text.split("=" * 80 + "\n")
        heads = [part.split("\n", 1)[0] for part in parts]
        assert "DiagnosticStatus[] status" in parts[0]
        assert {
            "MSG: std_msgs/Header",
            "MSG: diagnostic_msgs/DiagnosticStatus",
            "MSG: diagnostic_msgs/KeyValue",
        } <= set(heads)
        assert len(heads) == len(set(heads))
        with pytest.raises(ConfigError, match="no_such/Type"):
            served.raw_format("no_such/Type")
