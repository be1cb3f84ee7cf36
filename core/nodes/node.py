"""What the nodes share: topics and types, names, and how a change of their parameters is refused or described."""

from __future__ import annotations

import os
from functools import partial
from typing import Callable, Iterable, Mapping

from ..config import NODE_PARAMETERS, MonitorConfig
from ..port import NOTHING_CHANGED, Middleware, Timer
from ..values import ConfigError, Status, bound_text
from .outlets import array_message

FLOAT_TYPE = "std_msgs/Float32"
STRING_TYPE = "std_msgs/String"
LOG_LEVEL = "log_level"
DIAGNOSTICS = "/diagnostics"
UNAVAILABLE_SENSORS = "_unavailable_sensors"
"""Topic on which battery_sensor lists the metrics that its host has no sensor for, separated by commas.

alert_system does not wait for their samples: a desktop without a battery is not a robot whose battery fell silent.
"""
SIMULATED_SENSORS = "_simulated_sensors"
"""Topic on which battery_sensor lists the topics of its simulated metrics, separated by commas.

They are judged like all others. A target is notified of them only if it has `simulated: true`.
"""

Sections = Mapping[str, Mapping[str, object]]
"""Values by key, in named sections (signals, metrics); the section "" holds the node's own values."""


class RateTimer:
    """Calls a function with the time, at a rate that may change."""

    def __init__(self, middleware: Middleware, callback: Callable[[float], None], *, steady: bool = False) -> None:
        """Does not call yet; `steady` is of `Middleware.create_timer`."""
        self._create = partial(middleware.create_timer, callback=callback, steady=steady)
        self._rate_hz = 0.0
        self._timer: Timer | None = None

    def set_rate(self, rate_hz: float) -> None:
        """Calls so often per second from now on."""
        if rate_hz != self._rate_hz:
            if self._timer is not None:
                self._timer.cancel()
            self._rate_hz = rate_hz
            self._timer = self._create(1.0 / rate_hz)


def publish_statuses(middleware: Middleware, statuses: Callable[[], Iterable[Status]]) -> None:
    """Publishes statuses of a node on /diagnostics, if it has listeners."""
    if middleware.has_listeners(DIAGNOSTICS):
        middleware.publish(DIAGNOSTICS, array_message(statuses(), base_name(middleware)))


def host_name() -> str:
    """Returns the name of this host: the name of a robot that has none."""
    return os.uname().nodename  # as platform.node(), whose module takes memory in every node


def base_name(middleware: Middleware) -> str:
    """Returns the node's name without its namespace."""
    return middleware.name.rpartition("/")[2]


def refuse_changes(old: Mapping[str, object], new: Mapping[str, object], *, except_for: tuple[str, ...] = ()) -> None:
    """Raises ConfigError if common parameters change that are fixed at the start: not `log_level` and `except_for`."""
    fixed = {each.name: each.default for each in NODE_PARAMETERS if each.name not in (LOG_LEVEL, *except_for)}
    changed = [name for name, default in fixed.items() if new.get(name, default) != old.get(name, default)]
    if changed:
        raise ConfigError.joined([ConfigError("can only be set at the start", (name,)) for name in changed])


def sections_of(config: MonitorConfig, **own: object) -> Sections:
    """Returns the values of a configuration of alert_system, and further ones of the node itself."""
    signals = {name: vars(signal) for name, signal in config.signals.items()}
    return {"": {"publish_rate": config.publish_rate, "show": config.show, **own}, **signals}


def describe_changes(old: Sections, new: Sections) -> str:
    """Returns what differs, in the order of `new`: `wheel.warn_below: 20 -> 25; added imu`, or `nothing changed`."""
    texts: list[str] = []
    for section, values in new.items():
        if section not in old:
            texts.append(f"added {section}")
            continue
        prefix = f"{section}." if section else ""
        for key in dict.fromkeys([*old[section], *values]):
            before, after = old[section].get(key), values.get(key)
            if before != after:
                texts.append(f"{prefix}{key}: {_text(before)} -> {_text(after)}")
    texts.extend(f"removed {section}" for section in old if section not in new)
    return "; ".join(texts) or NOTHING_CHANGED


def _text(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return bound_text(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text, value))}]"
    return str(value) or '""'
