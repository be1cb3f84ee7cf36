"""Histories of signals that a monitor watches in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, NamedTuple, Sequence, Tuple

from robot_health_monitor.core import Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.core.judge.monitor import Monitor
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

START_S = 1_700_000_000.0


class Of(NamedTuple):
    """The datum of another signal."""

    signal: str
    value: Any


Timeline = Sequence[Tuple[float, Any]]
"""Time in s and datum; None is a tick."""


def watched(file: Path, signals: Mapping[str, Any], name: str, timeline: Timeline) -> Path:
    """Stores what a monitor with a history announces."""
    now_s = [0.0]
    history = History(HistorySettings(str(file)), lambda: START_S + now_s[0])
    config = load_config({"signals": signals})
    monitor = Monitor(config, "r3")
    continuity = Continuity(monitor, history.of_robot("r3"))
    continuity.record_configuration(config)
    continuity.restore(0.0, at_first_call=False)
    monitor.tick(0.0)
    for now_s[0], datum in timeline:
        signal, value = datum if isinstance(datum, Of) else (name, datum)
        changes = monitor.tick(now_s[0]) if datum is None else monitor.observe(Sample(signal, value, now_s[0]))
        for each in changes:
            continuity.record(each)
        if datum is None:
            continuity.save(now_s[0])
    history.run(lambda connection: None, 30.0)
    history.close()
    return file


def every_second(values: Sequence[Any]) -> list[tuple[float, Any]]:
    """Returns a sample each second, `...` for none, with a tick half a second after each."""
    found: list[tuple[float, Any]] = []
    for number, value in enumerate(values):
        found += [(float(number), value)] if value is not ... else []
        found.append((number + 0.5, None))
    return found
