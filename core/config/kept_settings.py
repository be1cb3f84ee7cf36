"""The settings of signals as a history keeps them: the keys that a thresholds.yaml would have."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from ..values import JsonObject
from .signal_config import LINK, LINK_CONFIG, SignalConfig, read_signal


def read_kept(kept: JsonObject) -> dict[str, SignalConfig]:
    """Returns the signals of a stored configuration by their names, `link` included.

    Raises ConfigError if a signal cannot be read, for example because another program has changed it.
    """
    return {**{name: read_signal(name, settings, (name,)) for name, settings in kept.items()}, LINK: LINK_CONFIG}


def settings_of(signal: SignalConfig) -> dict[str, Any]:
    """Returns the keys of a signal that differ from their defaults, as a thresholds.yaml has them."""
    given: dict[str, Any] = {}
    for key, value in vars(signal).items():
        default = getattr(SignalConfig, key, None)
        left_out: JsonObject = {key: default}
        # A default may follow from other keys.
        if key != "name" and value != default and getattr(replace(signal, **left_out), key) != value:
            given[key] = value
    settings: dict[str, Any] = json.loads(json.dumps(given, default=lambda condition: condition.settings))
    return settings
