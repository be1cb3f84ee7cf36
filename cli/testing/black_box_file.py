"""What a black box has attached to its recording: the thresholds in force, and the states of the signals."""

from __future__ import annotations

import os
from typing import Optional

from ...core.config.yaml_file import YamlFile, parse_yaml
from ...core.judge.attachments import STATE, THRESHOLDS, SavedMonitor, read_saved_monitor
from ...core.values.errors import ConfigError, MessageError
from ...recordings.reading import Recordings


def attached_file(recordings: Recordings) -> Optional[YamlFile]:
    """Returns the attached thresholds, None if there are none. Raises ConfigError if they are no YAML."""
    if THRESHOLDS not in recordings.attachments:
        return None
    return parse_yaml(recordings.attachments[THRESHOLDS].text, os.path.join(recordings.paths[0], THRESHOLDS))


def attached_states(recordings: Recordings) -> Optional[SavedMonitor]:
    """Returns the states at the beginning, None if there are none. Raises ConfigError if they cannot be read."""
    if STATE not in recordings.attachments:
        return None
    try:
        return read_saved_monitor(recordings.attachments[STATE].text)
    except MessageError as error:
        raise ConfigError(str(error), file=recordings.paths[0]) from None
