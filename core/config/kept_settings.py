"""The settings of signals as a history keeps them: the keys that a thresholds.yaml would have."""

from __future__ import annotations

from typing import Any, Dict, Mapping

from .signal_config import CONDITIONS, LINK, LINK_CONFIG, SIGNAL_PARAMETERS, SignalConfig, fill_in, read_signal

_DEFAULTS: Mapping[str, Any] = {parameter.name: parameter.default for parameter in SIGNAL_PARAMETERS}


def read_kept(kept: Mapping[str, Any]) -> Dict[str, SignalConfig]:
    """Returns the signals of a stored configuration by their names, `link` included.

    Raises ConfigError if a signal cannot be read, for example because another program has changed it.
    """
    return {**{name: read_signal(name, settings, (name,)) for name, settings in kept.items()}, LINK: LINK_CONFIG}


def settings_of(signal: SignalConfig) -> Dict[str, Any]:
    """Returns the keys of a signal that differ from their defaults, as a thresholds.yaml has them."""
    settings = {}
    for key, default in _DEFAULTS.items():
        value = getattr(signal, key)
        if value is not None and value != default:
            settings[key] = list(value) if isinstance(value, tuple) else value
    for key in [key for key in settings if _DEFAULTS[key] is None]:
        values = {**_DEFAULTS, **settings, key: None}
        fill_in(signal.name, values)
        if values[key] == settings[key]:
            del settings[key]
    for key in CONDITIONS:
        condition = getattr(signal, key)
        if condition is not None:
            is_between = condition.comparison == "between"
            number = [condition.number, condition.upper] if is_between else condition.number
            settings[key] = {"signal": condition.signal, condition.comparison: number}
    return settings
