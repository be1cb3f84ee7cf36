"""The settings of signals as a history keeps them: read again, and as the keys that a thresholds.yaml would have.

`Continuity.record_configuration` stores every key, a condition as text; `settings_of` leaves out what follows from the
rest.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any, Dict, Mapping

from .errors import ConfigError
from .signal_config import CONDITIONS, LINK, LINK_CONFIG, Condition, SignalConfig, read_signal

_DEFAULTS: Mapping[str, Any] = {
    field.name: field.metadata["parameter"].default
    for field in dataclasses.fields(SignalConfig)
    if "parameter" in field.metadata
}
_NUMBER = r"[^ ]+"
_CONDITION = re.compile(
    rf"(?P<signal>.+) is (?:(?P<side>below|above) (?P<bound>{_NUMBER})"
    rf"|between (?P<low>{_NUMBER}) and (?P<high>{_NUMBER})|not (?P<is_not>{_NUMBER})|(?P<is>{_NUMBER}))\Z"
)


def read_kept(kept: Mapping[str, Any]) -> Dict[str, SignalConfig]:
    """Returns the signals of a stored configuration by their names, `link` included.

    Raises:
        ConfigError: a signal cannot be read, for example because another program has changed it.
    """
    signals: Dict[str, SignalConfig] = {}
    for name, settings in kept.items():
        if name:
            if not isinstance(settings, Mapping):
                raise ConfigError("expected the settings of a signal", (name,))
            given = {key: settings[key] for key in _DEFAULTS if settings.get(key) is not None}
            conditions = {key: _condition(settings[key]) for key in CONDITIONS if isinstance(settings.get(key), str)}
            if not conditions.keys() >= {key for key in CONDITIONS if settings.get(key) is not None}:
                raise ConfigError("expected a condition in words", (name,))
            signals[name] = read_signal(name, {**_without_what_follows(name, given), **conditions}, (name,))
    return {**signals, LINK: LINK_CONFIG}


def settings_of(signal: SignalConfig) -> Dict[str, Any]:
    """Returns the keys of a signal that differ from their defaults, as a thresholds.yaml has them."""
    given = {key: getattr(signal, key) for key in _DEFAULTS if getattr(signal, key) is not None}
    settings = _without_what_follows(signal.name, given)
    for key in CONDITIONS:
        condition = getattr(signal, key)
        if condition is not None:
            settings[key] = _condition_settings(condition)
    return settings


def _without_what_follows(name: str, given: Mapping[str, Any]) -> Dict[str, Any]:
    """Leaves out defaults, and values that reading would fill in by itself."""
    settings = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in given.items()
        if value != _DEFAULTS[key] and not (key == "placeholders" and not value)
    }
    for key, default in _DEFAULTS.items():
        if default is None and key in settings:
            without = {each: value for each, value in settings.items() if each != key}
            try:
                if getattr(read_signal(name, without), key) == settings[key]:
                    settings = without
            except ConfigError:
                pass  # it is required
    return settings


def _condition(text: str) -> Dict[str, Any]:
    """Reads a condition in the words of `Condition.text`."""
    found = _CONDITION.match(text)
    try:
        if found is not None:
            if found["side"]:
                return {"signal": found["signal"], found["side"]: float(found["bound"])}
            if found["low"]:
                return {"signal": found["signal"], "between": [float(found["low"]), float(found["high"])]}
            key = "is_not" if found["is_not"] else "is"
            return {"signal": found["signal"], key: float(found[key])}
    except ValueError:
        pass
    raise ConfigError(f"expected a condition such as 'b is above 1', got {text[:60]!r}")


def _condition_settings(condition: Condition) -> Dict[str, Any]:
    is_between = condition.comparison == "between"
    number = [condition.number, condition.upper] if is_between else condition.number
    return {"signal": condition.signal, condition.comparison: number}
