"""What a black box attaches to a recording, so that it can be judged again: the configuration and the saved states.

`ops/black_box` writes these files into the recording, `recordings/mcap_file.py` reads them.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any, Mapping, NamedTuple

from ..config import MonitorConfig, settings_of
from ..values import MessageError, read_json
from .saved_state import SavedSignal

THRESHOLDS = "thresholds.yaml"
"""Name of the attachment with the configuration in force."""
STATE = "state.json"
"""Name of the attachment with the states of the signals at the beginning."""

TICKS = "/alert_system/tick"
"""Topic with an empty message (std_msgs/Empty) for each tick, so that a replay ticks at the same times."""


_LATEST_S = 9e9
"""Times of messages are nanoseconds in 64 bits."""


class SavedMonitor(NamedTuple):
    """The state of a monitor at one moment."""

    robot: str
    time_s: float
    """When, in s since 1970."""
    states: Mapping[str, SavedSignal]
    """State of each signal, as `Monitor.snapshot` returns it."""

    def to_json(self, offset_s: float = 0.0) -> str:
        """Returns it as the text of `STATE`, with all times later by `offset_s`: it may be of another clock."""
        states = {name: _moved(state, offset_s) for name, state in self.states.items()}
        return json.dumps({"robot": self.robot, "time_s": self.time_s + offset_s, "signals": states})


def read_saved_monitor(text: str) -> SavedMonitor:
    """Reads the text of `STATE`; raises MessageError. The states themselves are checked when they are restored."""
    with suppress(ValueError, KeyError, TypeError):
        tree = read_json(text)
        saved = SavedMonitor(tree["robot"], tree["time_s"], tree["signals"])
        kinds_match = (
            isinstance(saved.robot, str) and isinstance(saved.time_s, float) and isinstance(saved.states, dict)
        )
        if kinds_match and 0.0 <= saved.time_s <= _LATEST_S:
            return saved
    raise MessageError(f"{STATE}: expected robot, time_s in seconds since 1970, and signals")


def thresholds_tree(
    config: MonitorConfig, robot: str, topics: Mapping[str, str], *, use_sim_time: bool
) -> dict[str, Any]:
    """Returns a configuration as the mapping of a thresholds.yaml, which reads as the same signals.

    `topics` has the absolute name for each topic that it names otherwise.
    """
    signals = {
        name: {
            **settings_of(signal),
            "action" if signal.action else "topic": topics.get(signal.topic, signal.topic),
        }
        for name, signal in config.signals.items()
    }
    parameters: dict[str, Any] = {"robot_name": robot, "publish_rate": config.publish_rate, "signals": signals}
    if use_sim_time:
        parameters["use_sim_time"] = True
    return {"alert_system": {"ros__parameters": parameters}}


def _moved(state: SavedSignal, offset_s: float) -> SavedSignal:
    """Returns a state of `Monitor.snapshot` with its times moved; its format is that of core/judge/saved_state.py."""
    moved = dict(state)
    if "since" in state:
        moved["since"] = {name: time_s + offset_s for name, time_s in state["since"].items()}
    if "storm" in state:
        moved["storm"] = [time_s + offset_s for time_s in state["storm"]]
    return moved
