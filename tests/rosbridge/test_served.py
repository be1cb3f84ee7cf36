"""A node on a local bus can be served to rosbridge clients."""

from __future__ import annotations

from typing import Any

import pytest
from harness.local import LocalHarness
from harness.served_conformance import ServedConformance


class TestLocalServed(ServedConformance):
    @pytest.fixture
    def harness(self) -> Any:
        return LocalHarness()

    @pytest.fixture
    def served(self, harness: LocalHarness) -> Any:
        return harness.bus.node("bridge")
