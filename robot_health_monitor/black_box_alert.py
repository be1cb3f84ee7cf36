"""The alerts of a black box, for their unit tests: what a replay announces, with the samples that led to it."""

from __future__ import annotations

import math
import os
from typing import Any, Counter, Dict, List, Tuple

from robot_health_monitor.core.config import Section, read_monitor
from robot_health_monitor.core.element_signals import element_signal_name
from robot_health_monitor.core.elements import Elements
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.signal_config import SignalConfig, template_name
from robot_health_monitor.recordings.judging import Judge, JudgedEvent
from robot_health_monitor.recordings.middleware import Player, Subscription
from robot_health_monitor.recordings.reading import Recordings

from .alert_attempts import RecordedAlert, depends_on
from .black_box_file import attached_file, attached_section, attached_states
from .past_alert import FROM_ALERT, PastAlert, needed_settings

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
        section = attached_section(file)
        try:
            replayed = _Replay(recordings, section)
        except ConfigError as error:
            raise file.locate(error.below(section.path)) from None
        found = replayed.alerts(os.path.basename(path))
    if not found:
        raise ConfigError(f"{FROM_ALERT}: gives no alert when it is replayed", file=path)
    return found


class _Replay:
    """A black box, judged by its own thresholds from its own states on."""

    def __init__(self, recordings: Recordings, section: Section) -> None:
        saved = attached_states(recordings)
        self._config = read_monitor(Section((), section.tree))
        self._transitions: List[Transition] = []
        self._samples: Dict[str, List[Tuple[float, float]]] = {}
        self._bad = Counter[str]()
        player = Player(
            recordings,
            use_sim_time=section.tree.get("use_sim_time") is True,
            begin_ns=None if saved is None else round(saved.time_s * 1e9),
        )
        self._begin_s = player.wall_s
        judge = Judge(player, self._note)
        judge.add(_JUDGED, section.tree, saved)
        self._monitor = judge.monitor(_JUDGED)
        self._node = player.node("alert_system", {})
        for signal in self._config.signals.values():
            self._collect(player, signal)
        judge.run()

    def alerts(self, name: str) -> List[PastAlert]:
        """Returns its alerts; `name` is that of the file."""
        found: List[PastAlert] = []
        robot = self._config.robot_name
        for place, transition in enumerate(self._transitions):
            if transition.to_level is Level.OK:
                continue
            signals = self._config.signals
            earlier = [each for each in self._transitions[:place] if each.signal == transition.signal]
            before = [self._recorded(each)._replace(samples=()) for each in earlier]
            recorded = self._recorded(transition)._replace(before=before)
            template = signals.get(template_name(transition.signal))
            if template is None or (template.is_template and template.name == transition.signal):
                continue  # the link, or a template: they have no samples
            settings = needed_settings(signals, transition.signal, robot)
            others = {
                each: [sample for sample in self._samples.get(each, []) if sample[0] <= transition.now_s]
                for each in depends_on(template)
            }
            title = f"alert {len(found) + 1} of {printable(name)}"
            found.append(PastAlert(title, transition.text, settings, recorded, others))
        return found

    def _recorded(self, transition: Transition) -> RecordedAlert:
        samples = [each for each in self._samples.get(transition.signal, []) if each[0] <= transition.now_s]
        return RecordedAlert(
            transition.signal, transition.from_level, transition.to_level, transition.now_s, transition.value,
            transition.bound, samples, recorded_since_s=self._begin_s,
        )  # fmt: skip

    def _note(self, judged: JudgedEvent) -> None:
        if isinstance(judged.event, Transition) and not judged.event.repeat:
            self._transitions.append(judged.event)

    def _collect(self, player: Player, signal: SignalConfig) -> None:
        """Collects what the monitor made of each message; after its own subscription, so that it has been judged."""

        def collect(value: Any, wall_s: float) -> None:
            if isinstance(value, Elements) and signal.is_template:
                for element, _ in value:
                    self._note_sample(element_signal_name(signal.name, element))
            else:
                self._note_sample(signal.name)

        topic = self._node.resolve(signal.topic)
        player.subscribe(Subscription(self._node, topic, collect), signal.type, signal.field or None)

    def _note_sample(self, name: str) -> None:
        now_s = self._node.now_s()
        newest = self._monitor.window_samples(name, 1)
        samples = self._samples.setdefault(name, [])
        if newest and (not samples or newest[-1][0] > samples[-1][0]) and newest[-1][0] >= now_s - 1e-6:
            samples.append(newest[-1])
            return
        status = self._monitor.status(name, now_s)
        bad = 0 if status is None else int(status.values["bad_samples"])
        if bad > self._bad[name]:
            samples.append((now_s, math.nan))
        self._bad[name] = bad
