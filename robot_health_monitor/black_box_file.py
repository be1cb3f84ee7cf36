"""What a black box has attached to its recording: the thresholds in force, and the states of the signals."""

from __future__ import annotations

import os
from typing import Optional

from robot_health_monitor.core.attachments import STATE, THRESHOLDS, SavedMonitor, read_saved_monitor
from robot_health_monitor.core.config import Section
from robot_health_monitor.core.errors import ConfigError, MessageError
from robot_health_monitor.core.yaml_file import YamlFile, parse_yaml
from robot_health_monitor.recordings.reading import Recordings

from .embedded import sections_of_nodes


def attached_file(recordings: Recordings) -> Optional[YamlFile]:
    """Returns the attached thresholds; None: there are none. Raises ConfigError: they are no YAML."""
    if THRESHOLDS not in recordings.attachments:
        return None
    return parse_yaml(recordings.attachments[THRESHOLDS].text, os.path.join(recordings.paths[0], THRESHOLDS))


def attached_section(file: YamlFile) -> Section:
    """Returns the section of alert_system. Raises ConfigError."""
    return sections_of_nodes(file)["alert_system"]


def attached_states(recordings: Recordings) -> Optional[SavedMonitor]:
    """Returns the states at the beginning; None: there are none. Raises ConfigError: they cannot be read."""
    if STATE not in recordings.attachments:
        return None
    try:
        return read_saved_monitor(recordings.attachments[STATE].text)
    except MessageError as error:
        raise ConfigError(str(error), file=recordings.paths[0]) from None
