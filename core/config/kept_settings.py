"""The settings of signals as a history keeps them: the keys that a thresholds.yaml would have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..values import JsonObject
from .signal_config import CONDITIONS, LINK, LINK_CONFIG, SIGNAL_PARAMETERS, SignalConfig, read_signal

_DEFAULTS: JsonObject = {parameter.name: parameter.default for parameter in SIGNAL_PARAMETERS}


def read_kept(kept: JsonObject) -> dict[str, SignalConfig]:
    """Returns the signals of a stored configuration by their names, `link` included.

    Raises ConfigError if a signal cannot be read, for example because another program has changed it.
    """
    return {**{name: read_signal(name, settings, (name,)) for name, settings in kept.items()}, LINK: LINK_CONFIG}


def settings_of(signal: SignalConfig) -> dict[str, Any]:
    """Returns the keys of a signal that differ from their defaults, as a thresholds.yaml has them."""
    settings: dict[str, Any] = {}

    def follows(key: str) -> bool:
        """Whether the value of a key is the one that follows from the others if it is left out."""
        left_out: dict[str, Any] = {key: None}
        return bool(getattr(replace(signal, **left_out), key) == getattr(signal, key))

    for key, default in _DEFAULTS.items():
        value = getattr(signal, key)
        if value not in (None, default) and not (default is None and follows(key)):
            settings[key] = list(value) if isinstance(value, tuple) else value
    for key in CONDITIONS:
        condition = getattr(signal, key)
        if condition is not None:
            settings[key] = {
                name: list(value) if isinstance(value, tuple) else value for name, value in condition.settings.items()
            }
    return settings
