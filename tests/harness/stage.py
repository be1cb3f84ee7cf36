"""A bus in virtual time around the nodes under test, with a node that publishes by hand and one that listens."""

from __future__ import annotations

from typing import Any, Mapping

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Outlet
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.port.middleware import Severity

FLOAT32 = "std_msgs/Float32"


class Stage:
    """A bus with a node that publishes by hand, and one that listens."""

    def __init__(self) -> None:
        self.bus = LocalBus()
        self.outside = self.bus.node("outside")

    def publish(self, topic: str, value: float) -> None:
        self.outside.advertise(topic, FLOAT32)
        self.outside.publish(topic, {"data": value})

    def set_clock(self, now_s: float) -> None:
        """Publishes on /clock; `now_s` in multiples of a nanosecond."""
        self.outside.advertise("/clock", "rosgraph_msgs/Clock")
        seconds = int(now_s)
        self.outside.publish("/clock", {"clock": {"sec": seconds, "nanosec": round((now_s - seconds) * 1e9)}})

    def listen(self, topic: str, field: str = "") -> list[Any]:
        messages: list[Any] = []
        self.outside.subscribe(topic, "", lambda value, now_s: messages.append(value), field=field)
        return messages

    def log(self, *severities: Severity) -> list[str]:
        return [line.text for line in self.bus.log_lines if line.severity in severities]

    def alert_system(
        self,
        parameters: Mapping[str, Any] | None = None,
        outlets: Mapping[str, Outlet] | None = None,
        *,
        log_alerts: bool = True,
        use_sim_time: bool = False,
        **options: Any,
    ) -> tuple[AlertSystem, LocalMiddleware]:
        """Starts an alert_system; `options` are further ones of `AlertSystem`."""
        middleware = self.bus.node("alert_system", parameters=parameters, use_sim_time=use_sim_time)
        return AlertSystem(middleware, outlets or {}, log_alerts=log_alerts, **options), middleware


def status(array: Any, name: str) -> Any:
    """Returns the status of a name in a DiagnosticArray."""
    (found,) = [one for one in array["status"] if one["name"] == name]
    return found


def values_of(message: Any) -> dict[str, str]:
    """Returns the key-values of a DiagnosticStatus."""
    return {pair["key"]: pair["value"] for pair in message["values"]}
