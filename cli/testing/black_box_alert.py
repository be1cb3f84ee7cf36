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

_JUDGED = "black box"  # name of its configuration within `Judge`


def black_box_alerts(path: str) -> List[PastAlert]:
    """Returns the alerts that a black box has recorded, in the order in which they came.

    Raises:
        ConfigError: it cannot be read, is no black box, or has no alert that a test can have.
    """
    with Recordings([path]) as recordings:
        file = attached_file(recordings)
        if file is None:
            raise ConfigError(f"{FROM_ALERT}: has no thresholds.yaml; expected a black box", file=path)
        section = sections_of_nodes(file)["alert_system"]
        with file.located(section.path):
            replayed = _Replay(recordings, section)
        alerts = replayed.alerts(os.path.basename(path))
    if not alerts:
        raise ConfigError(f"{FROM_ALERT}: gives no alert when it is replayed", file=path)
    return alerts


class _Replay:
    """A black box, judged by its own thresholds from its own states on."""

    def __init__(self, recordings: Recordings, section: Section) -> None:
        saved = attached_states(recordings)
        self._config = read_monitor(Section((), section.tree))
        self._transitions: List[Tuple[float, Transition]] = []
        self._samples: Dict[str, List[Tuple[float, float]]] = {}
        player = Player(
            recordings,
            use_sim_time=section.tree.get("use_sim_time") is True,
            begin_ns=None if saved is None else round(saved.time_s * 1e9),
        )
        self._begin_s = player.wall_s
        judge = Judge(player, self._note, self._collect)
        judge.add(_JUDGED, section.tree, saved)
        judge.run()

    def alerts(self, name: str) -> List[PastAlert]:
        """Returns its alerts; `name` is that of the file."""
        found: List[PastAlert] = []
        signals, robot = self._config.signals, self._config.robot_name
        for wall_s, transition in self._transitions:
            signal = signals.get(template_name(transition.signal))
            is_own = signal is None or (signal.is_template and signal.name == transition.signal)
            if signal is None or is_own or transition.to_level is Level.OK:
                continue  # a source, the link or a template: they have no samples
            names = [transition.signal, *depends_on(signal)]
            before_s = math.ceil(wall_s - self._begin_s)
            missing = f"what came before the recording, which begins {before_s} s before it, is missing"
            longer_s = max(needed_before_s(signal), 2 * before_s)
            found.append(
                PastAlert(
                    title=f"alert {len(found) + 1} of {printable(name)}",
                    line=transition.text,
                    wall_s=wall_s,
                    settings=needed_settings(signals, transition.signal, robot),
                    signal=transition.signal,
                    from_level=transition.from_level,
                    to_level=transition.to_level,
                    time_s=transition.now_s,
                    samples={each: self._samples[each] for each in names if each in self._samples},
                    missing=f"{missing}; black_box: before_s: {longer_s} in ops.yaml would have recorded it",
                )
            )
        return found

    def _note(self, judged: JudgedEvent) -> None:
        if isinstance(judged.event, Transition) and not judged.event.repeat:
            self._transitions.append((judged.wall_s, judged.event))

    def _collect(self, _: str, signal: SignalConfig, sample: JudgedSample) -> None:
        value = math.nan if sample.value is None else sample.value
        self._samples.setdefault(signal.name, []).append((sample.now_s, value))


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
