"""The client over a real socket, through this project's server, keeps the port's promises."""

from __future__ import annotations

from typing import Any

import pytest
from harness.black_box_conformance import BlackBoxConformance
from harness.port_conformance import PortConformance
from harness.raw_conformance import RawConformance


class OnRobot:
    """A node on the robot's bus, whose methods are called in the thread of the bus."""

    def __init__(self, harness: Any, name: str) -> None:
        self._harness = harness
        self._node = harness.on_robot(lambda: harness.bus.node(name))

    def __getattr__(self, method: str) -> Any:
        return lambda *arguments: self._harness.on_robot(lambda: getattr(self._node, method)(*arguments))


class TestRosbridge(BlackBoxConformance, RawConformance, PortConformance):
    def other_node(self, harness: Any, name: str) -> Any:
        return OnRobot(harness, name)

    @pytest.fixture
    def harness(self) -> Any:
        from harness.rosbridge import RosbridgeHarness

        return RosbridgeHarness()
