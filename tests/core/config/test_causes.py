"""`depends_on`: what depends on what, directly or not. What follows is tested in tests/core/judge/test_causes.py."""

from __future__ import annotations

from typing import Any, Mapping

from robot_health_monitor.core import load_config
from robot_health_monitor.core.config.causes import causes_of
from robot_health_monitor.core.config.signal_config import SignalConfig


def configured(**signals: Mapping[str, Any]) -> Mapping[str, SignalConfig]:
    return load_config({"signals": signals}).signals


def test_causes_come_before_what_they_cause_otherwise_in_the_order_of_the_configuration() -> None:
    signals = configured(c={"depends_on": ["b"]}, x={}, b={"depends_on": ["a"]}, a={}, y={"depends_on": ["x"]})
    assert causes_of(signals).first(signals) == ["a", "b", "c", "x", "y"]


def test_the_nearest_cause_comes_first_and_each_brings_its_source() -> None:
    signals = configured(
        speed={"topic": "odom", "depends_on": ["motor", "link"]},
        motor={"topic": "/motor", "depends_on": ["power"]},
        power={},
    )
    causes = causes_of(signals, lambda topic: f"/r1/{topic.lstrip('/')}")
    assert list(causes.of("speed")) == ["motor", "link", "power", "/r1/motor", "/r1/power"]
    assert causes.nearest("speed", {"power", "/r1/motor"}) == "power"
    assert causes.nearest("power", {"power"}) == ""
    assert causes.names == {"motor", "link", "power", "/r1/motor", "/r1/power"}


def test_elements_have_the_causes_of_their_template() -> None:
    signals = configured(cells={"field": "cell_voltage[*]", "depends_on": ["/odom"]}, speed={"topic": "odom"})
    causes = causes_of(signals, lambda topic: f"/{topic.lstrip('/')}")
    assert list(causes.of("cells[7]")) == ["/odom"]
