"""The alerts of a black box, for their unit tests: what a replay announces, with the samples that led to it."""

from __future__ import annotations

import math
import os
from typing import Dict, List, Optional, Tuple

from ...core.config.monitor_config import Section, read_monitor
from ...core.config.signal_config import SignalConfig, template_name
from ...core.config.yaml_file import YamlFile, parse_yaml
from ...core.judge.attachments import STATE, THRESHOLDS, SavedMonitor, read_saved_monitor
from ...core.values.errors import ConfigError, MessageError
from ...core.values.formatting import printable
from ...core.values.model import Level, Transition
from ...recordings.judging import Judge, JudgedEvent, JudgedSample
from ...recordings.middleware import Player
from ...recordings.reading import Recordings
from ..embedded import sections_of_nodes
from .past_alert import FROM_ALERT, PastAlert, depends_on, needed_before_s, needed_settings


def black_box_alerts(path: str) -> List[PastAlert]:
    """Returns the alerts that a black box has recorded, in the order in which they came.

    It is judged by its own thresholds, from its own states on.

    Raises:
        ConfigError: it cannot be read, is no black box, or has no alert that a test can have.
    """
    events: List[JudgedEvent] = []
    samples: Dict[str, List[Tuple[float, float]]] = {}

    def collect(_: str, signal: SignalConfig, sample: JudgedSample) -> None:
        value = math.nan if sample.value is None else sample.value
        samples.setdefault(signal.name, []).append((sample.now_s, value))

    with Recordings([path]) as recordings:
        file = attached_file(recordings)
        if file is None:
            raise ConfigError(f"{FROM_ALERT}: has no thresholds.yaml; expected a black box", file=path)
        section = sections_of_nodes(file)["alert_system"]
        saved = attached_states(recordings)
        with file.located(section.path):
            config = read_monitor(Section((), section.tree))
            player = Player(
                recordings,
                use_sim_time=section.tree.get("use_sim_time") is True,
                begin_ns=None if saved is None else round(saved.time_s * 1e9),
            )
            begin_s = player.wall_s
            judge = Judge(player, events.append, collect)
            judge.add("", section.tree, saved)
            judge.run()
    alerts: List[PastAlert] = []
    for judged in events:
        transition = judged.event
        if not isinstance(transition, Transition) or transition.repeat or transition.to_level is Level.OK:
            continue
        signal = config.signals.get(template_name(transition.signal))
        if signal is None or (signal.is_template and signal.name == transition.signal):
            continue  # a source, the link or a template: they have no samples
        names = [transition.signal, *depends_on(signal)]
        before_s = math.ceil(judged.wall_s - begin_s)
        longer_s = max(needed_before_s(signal), 2 * before_s)
        alerts.append(
            PastAlert(
                title=f"alert {len(alerts) + 1} of {printable(os.path.basename(path))}",
                transition=transition,
                wall_s=judged.wall_s,
                settings=needed_settings(config.signals, transition.signal, config.robot_name),
                time_s=transition.now_s,
                samples={each: samples[each] for each in names if each in samples},
                missing=f"what came before the recording, which begins {before_s} s before it, is missing; "
                f"black_box: before_s: {longer_s} in ops.yaml would have recorded it",
            )
        )
    if not alerts:
        raise ConfigError(f"{FROM_ALERT}: gives no alert when it is replayed", file=path)
    return alerts


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
