"""What a change of configuration changed, as one line: the response of `~reload`."""

from __future__ import annotations

from typing import List, Mapping

from ..config import MonitorConfig
from ..formatting import bound_text
from ..middleware import NOTHING_CHANGED

Sections = Mapping[str, Mapping[str, object]]
"""Values by key, in named sections (signals, metrics); the section "" holds the node's own values."""


def sections_of(config: MonitorConfig, **own: object) -> Sections:
    """Returns the values of a configuration of alert_system, and further ones of the node itself."""
    signals = {name: vars(signal) for name, signal in config.signals.items()}
    return {"": {"publish_rate": config.publish_rate, **own}, **signals}


def describe_changes(old: Sections, new: Sections) -> str:
    """Returns what differs, in the order of `new`: `wheel.warn_below: 20 -> 25; added imu`, or `nothing changed`."""
    texts: List[str] = []
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
