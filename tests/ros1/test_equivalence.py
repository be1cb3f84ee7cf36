"""rospy against a real master gives the same verdicts as the reference."""

from __future__ import annotations

from typing import Any

import pytest
from harness.equivalence import Equivalence


class TestRos1(Equivalence):
    @pytest.fixture
    def harness(self, ros_process: Any) -> Any:
        from harness.ros1 import Ros1Harness

        return Ros1Harness()
